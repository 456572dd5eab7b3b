"""What a file states of friction holds unless the caller states another; where it states none, that is said."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from tests.objects.meshes import MJCF, URDF
from tossid.errors import FileError, ObjectError
from tossid.objects import load_object, object_from_mjcf
from tossid.settings.objects import ObjectSettings

BOX = '<geom type="box" size="0.05 0.04 0.03" mass="0.2" {}/>'
LINK = '<collision><geometry><box size="0.1 0.1 0.1"/></geometry>{}</collision>'


def mjcf(folder: Path, *geoms: str, floor: str = "", defaults: str = "") -> Path:
    """A file with a floor and boxes of some attributes."""
    text = MJCF.format(assets="", geoms="".join(BOX.format(each) for each in geoms)).replace('friction="0.2"', floor)
    path = folder / "thing.xml"
    path.write_text(text.replace("<asset></asset>", f"<default>{defaults}</default>"))
    return path


def urdf(folder: Path, in_collision: str = "", beside: str = "") -> Path:
    """A file with words in its link's collision element, and beside the link."""
    path = folder / "thing.urdf"
    path.write_text(URDF.format(LINK.format(in_collision)).replace("</robot>", beside + "</robot>"))
    return path


STATED = {
    "at the geom": (['friction="0.9 0.005 0.0001"'], {}, 0.9),
    "of all geoms": ([""], {"defaults": '<geom friction="0.45"/>'}, 0.45),
    "of a class": (
        ['class="rubber"'],
        {"defaults": '<geom friction="0.1"/><default class="rubber"><geom friction="1.2"/></default>'},
        1.2,
    ),
    "MuJoCo's own number": (['friction="1"'], {}, 1.0),
    "of what collides": (['friction="0.3"', 'friction="0.8" contype="0" conaffinity="0"'], {}, 0.3),
    "two geoms agree": (['friction="0.3"', 'friction="0.3 0.1"'], {}, 0.3),
    "the floor's, which is larger": (['friction="0.3"'], {"floor": 'friction="0.5"'}, 0.5),
    "the floor's is MuJoCo's default": (['friction="0.3"'], {}, 0.3),
    "the floor's alone": ([""], {"floor": 'friction="0.5"'}, 0.5),
    "the floor's, of higher priority": (['friction="0.9"'], {"floor": 'friction="0.5" priority="1"'}, 0.5),
}


@pytest.mark.parametrize("where", STATED)
def test_what_mjcf_states_holds_and_is_said(where: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    geoms, others, expected = STATED[where]
    path = mjcf(tmp_path, *geoms, **others)
    caplog.set_level(logging.INFO, "tossid")
    assert load_object(path).friction == expected
    assert [record.levelno for record in caplog.records] == [logging.INFO]
    assert f"thing.xml states friction {expected:g}, which holds" in caplog.text


@pytest.mark.parametrize(
    ("in_collision", "beside", "expected"),
    [
        ('<drake:proximity_properties><drake:mu_static value="0.4"/></drake:proximity_properties>', "", 0.4),
        ('<drake:mu_static value="0.4"/><drake:mu_dynamic value="0.35"/>', "", 0.35),
        ('<contact_coefficients mu="0.6" kp="1000" kd="1"/>', "", 0.6),
        ("", '<gazebo reference="body"><mu1>0.7</mu1><mu2>0.7</mu2></gazebo>', 0.7),
        ("", '<gazebo reference="body"><mu1 value="0.8"/></gazebo>', 0.8),
        ('</collision><contact><lateral_friction value="0.55"/></contact><collision>', "", 0.55),
    ],
)
def test_what_urdf_states_holds(in_collision: str, beside: str, expected: float, tmp_path: Path) -> None:
    path = urdf(tmp_path, in_collision, beside)
    path.write_text(path.read_text().replace("<collision></collision>", ""))
    assert load_object(path).friction == expected
    assert load_object(path, friction=0.2).friction == 0.2


def test_the_published_elbow_has_the_friction_of_its_file(shared_data: Path) -> None:
    assert load_object(shared_data / "pll_elbow" / "contactnets_elbow.urdf").friction == 0.3
    assert load_object(shared_data / "basketball" / "ball.xml").friction == 0.6


@pytest.mark.parametrize("made", [lambda folder: mjcf(folder, ""), lambda folder: urdf(folder)])
def test_a_guess_is_said(made: object, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = made(tmp_path)  # type: ignore[operator]
    assert load_object(path).friction == 0.18
    assert f"{path.name} states no friction; 0.18 is a guess (object.friction states it)" in caplog.text
    assert [record.levelno for record in caplog.records] == [logging.WARNING]
    caplog.clear()
    assert load_object(path, friction=0.25).friction == 0.25
    assert not caplog.records


def test_a_key_goes_before_the_file_and_the_file_before_no_key(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = mjcf(tmp_path, 'friction="0.9"')
    caplog.set_level(logging.INFO, "tossid")
    settings = ObjectSettings(name="mine", path=path)
    assert load_object(settings).friction == 0.9
    caplog.clear()
    for model in (
        load_object(ObjectSettings(name="mine", path=path, friction=0.4)),
        load_object(settings, friction=0.4),
        load_object(path, friction=0.4),
    ):
        assert model.friction == 0.4
    assert set(caplog.messages) == {"thing.xml states friction 0.9; 0.4 holds instead"}


def test_several_frictions_are_refused_unless_one_is_given(tmp_path: Path) -> None:
    path = mjcf(tmp_path, 'friction="0.9"', 'friction="0.3"')
    several = r"thing\.xml: states friction 0\.3 and 0\.9 for parts of one object, expected one; object\.friction says"
    with pytest.raises(FileError, match=several):
        load_object(path)
    assert load_object(path, friction=0.5).friction == 0.5
    with pytest.raises(ObjectError, match=r"states friction 0\.3 and 0\.9"):
        object_from_mjcf(path.read_text())
    with pytest.raises(FileError, match=r"states friction 0\.3 and 1 "):  # MuJoCo's own where none is stated
        load_object(mjcf(tmp_path, 'friction="0.3"', ""))
    with pytest.raises(FileError, match=r"states friction 0\.3 and 0\.5 "):
        load_object(urdf(tmp_path, beside="<gazebo><mu1>0.5</mu1><mu2>0.3</mu2></gazebo>"))


def test_an_included_file_is_read_too(tmp_path: Path) -> None:
    path = mjcf(tmp_path, 'class="steel"', defaults='<default class="steel"/>')
    (tmp_path / "steel.xml").write_text('<mujoco><default><geom friction="1"/></default></mujoco>')
    path.write_text(path.read_text().replace("<default>", '<include file="steel.xml"/><default>', 1))
    assert load_object(path).friction == 1.0
