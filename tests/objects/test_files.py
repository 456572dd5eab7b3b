"""An object by name, file or settings; its tags, its friction, and the files that its text may ask for."""

from __future__ import annotations

import logging
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.objects.meshes import MJCF, URDF
from tossid.errors import ConfigError, FileError, ObjectError
from tossid.objects import OBJECT_FILES, load_object, object_from_mjcf, read_tags, recorded_object, write_object
from tossid.objects.references import check_alone, check_model_file, inside, stands_alone
from tossid.settings.objects import PRESETS, ObjectSettings
from tossid.vision.setup.layout import object_tags
from tossid.vision.setup.tagslam import read_tagslam

PUBLISHED_FRICTION = {"cube": 0.18, "elbow": 0.3}
"""The cube's as ContactNets states it, the elbow's as both links of dair_pll's contactnets_elbow.urdf have it."""


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_is_found_from_any_folder(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    model, preset = load_object(name), PRESETS[name]
    assert (model.name, model.friction, model.restitution, model.width) == (
        name,
        PUBLISHED_FRICTION[name],
        0.0,
        preset.width,
    )
    assert sorted(tag.id for tag in model.tags) == list(range(len(model.tags)))
    assert {tag.body for tag in model.tags} == set(range(model.n_bodies))


def test_the_cubes_tags_lie_in_the_middle_of_its_faces() -> None:
    centres = np.array([tag.T_body_tag[:3, 3] for tag in load_object("cube").tags])
    half = 0.0524
    expected = half * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    np.testing.assert_allclose(centres, expected, atol=1e-12)


def test_a_file_of_the_user_goes_before_tossids_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    own = tmp_path / PRESETS["cube"].path
    own.parent.mkdir(parents=True)
    own.write_text((OBJECT_FILES / "cube.xml").read_text().replace('mass="0.37"', 'mass="0.5"'))
    assert load_object("cube").mass.item() == 0.5


def test_a_file_is_an_object_with_the_values_that_are_stated(tmp_path: Path) -> None:
    shutil.copy(OBJECT_FILES / "elbow.xml", tmp_path / "mine.xml")
    model = load_object(
        str(tmp_path / "mine.xml"), name="mine", friction=0.4, width=0.2, tags=OBJECT_FILES / "elbow_tags.yaml"
    )
    assert (model.name, model.friction, model.width, len(model.tags)) == ("mine", 0.4, 0.2, 20)


def test_what_is_stated_goes_before_a_preset_and_a_loaded_object() -> None:
    assert load_object("cube", restitution=0.3).restitution == 0.3
    assert load_object(load_object("cube"), friction=0.5).friction == 0.5
    assert load_object(replace(PRESETS["cube"], friction=0.5), width=1.0).width == 1.0


def test_a_name_of_nothing_is_said_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match=r"no 'cubes'; expected cube, elbow or a file.*'cube'"):
        load_object("cubes")
    with pytest.raises(FileError, match="no such object file"):
        load_object("cubes.xml")


SOUND = "name: box\npath: object.xml\nfriction: 0.2\nrestitution: 0.0\nwidth: null\ntags: null\n"


def test_an_object_comes_back(tmp_path: Path) -> None:
    elbow = load_object("elbow")
    write_object(elbow, elbow.mjcf, tmp_path)
    (tmp_path / "tagslam.yaml").write_bytes((OBJECT_FILES / "elbow_tags.yaml").read_bytes())
    settings = recorded_object(tmp_path)
    assert settings.path == tmp_path / "object.xml"
    again, model = load_object(settings), load_object("elbow")
    assert (again.name, again.friction, again.width, len(again.tags)) == ("elbow", 0.3, 0.1, len(model.tags))
    assert again.mjcf == model.mjcf


@pytest.mark.parametrize(
    ("was", "now", "says"),
    [
        ("path: object.xml", f"path: {'x' * 300}", "path: .* will not do"),
        ("friction: 0.2", "friction: -0.2", "friction: -0.2 is out of range"),
        ("friction: 0.2", "friction: much", "friction: 'much' will not do; expected a number"),
        ("tags: null", "mass: 3", "mass: there is no such key"),
    ],
)
def test_what_is_no_object_is_said(tmp_path: Path, was: str, now: str, says: str) -> None:
    (tmp_path / "object.yaml").write_text(SOUND.replace(was, now))
    with pytest.raises(FileError, match=says):
        recorded_object(tmp_path)


POSE = "{position: {x: 0.1, y: 0, z: 0}, rotation: {x: 0, y: 0, z: 1.5707963267948966}}"


@pytest.mark.parametrize("name", ["cube", "elbow"])
def test_the_tags_are_those_that_the_reader_of_whole_scenes_finds(name: str) -> None:
    path, names = OBJECT_FILES / f"{name}_tags.yaml", load_object(name).body_names
    for ours, theirs in zip(read_tags(path, names), object_tags(read_tagslam(path), names), strict=True):
        assert (ours.id, ours.size, ours.body) == (theirs.id, theirs.size, theirs.body)
        np.testing.assert_array_equal(ours.T_body_tag, theirs.T_body_tag)


def test_a_tag_has_its_pose_and_the_bodys_default_size(tmp_path: Path) -> None:
    bodies = f"- box: {{is_static: false, default_tag_size: 0.05, tags: [{{id: 7, pose: {POSE}}}, {{id: 8}}]}}"
    (tag,) = read_tags(written(tmp_path, bodies), ["box"])  # tag 8 has no known pose
    assert (tag.id, tag.size, tag.body) == (7, 0.05, 0)
    expected = np.array([[0, -1, 0, 0.1], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    np.testing.assert_allclose(tag.T_body_tag, expected, atol=1e-12)


def test_the_only_moving_body_stands_for_an_object_of_one_body(tmp_path: Path) -> None:
    bodies = f"- rig: {{is_static: true}}\n- thing: {{is_static: false, tags: [{{id: 7, size: 0.05, pose: {POSE}}}]}}"
    assert len(read_tags(written(tmp_path, bodies), ["box"])) == 1
    with pytest.raises(ObjectError, match=r"no tag of known pose on box, lid \(bodies: rig, thing\)"):
        read_tags(written(tmp_path, bodies), ["box", "lid"])


@pytest.mark.parametrize(
    ("tags", "says"),
    [
        ("[{id: 7, size: 0.05, pose: 3}]", r"box.tags\[7\].pose needs position and rotation"),
        (f"[{{id: 7, size: -1, pose: {POSE}}}]", r"box.tags\[7\].size is -1.0, expected a positive length"),
        (f"[{{id: 7, pose: {POSE}}}]", r"box.tags\[7\].size is None, expected a finite number"),
        (f"[{{size: 0.05, pose: {POSE}}}]", "has no whole-number id"),
        (f"[{{id: 7, size: 0.05, pose: {POSE}}}, {{id: 7, size: 0.05, pose: {POSE}}}]", "a tag is listed twice"),
        ("5", "box.tags is 5, expected a list of tags"),
    ],
)
def test_what_is_no_tag_is_said(tmp_path: Path, tags: str, says: str) -> None:
    with pytest.raises(FileError, match=says):
        read_tags(written(tmp_path, f"- box: {{is_static: false, tags: {tags}}}"), ["box"])


def written(folder: Path, bodies: str) -> Path:
    (folder / "tagslam.yaml").write_text(f"bodies:\n{bodies}")
    return folder / "tagslam.yaml"


# ---------------------------------------------------------------- friction: a file's holds unless another is stated


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


# ---------------------------------------------------------------- files that a model asks for


BODY = '<worldbody><body><geom type="box" size="1 1 1"/></body></worldbody>'


def model(head: str = "", body: str = BODY) -> str:
    return f"<mujoco>{head}{body}</mujoco>"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (model('<include file="other.xml"/>'), "names another file or folder"),
        (model('<compiler meshdir="/etc"/>'), "names another file or folder"),
        (model('<extension><plugin plugin="x"/></extension>'), "models from outside may not have"),
        (model(body='<replicate count="1000000">' + BODY + "</replicate>"), "elements"),
        (model('<asset><texture name="t" builtin="flat" width="100000" height="100000"/></asset>'), "pixels"),
        (model('<size memory="1T"/>'), "MuJoCo's memory"),
        ("<!DOCTYPE x>" + model(), "document type"),
        ("<mujoco>", "not valid XML"),
        (model(body="<body>" * 70 + "</body>" * 70), "inside one another"),
    ],
)
def test_a_model_from_outside_stands_alone(text: str, says: str) -> None:
    with pytest.raises(ObjectError, match=says):
        check_alone(text)
    assert not stands_alone(text)
    assert stands_alone(model())


def test_a_file_from_outside_names_files_in_its_own_folder(tmp_path: Path) -> None:
    own = tmp_path / "own"
    own.mkdir()
    (own / "mesh.obj").touch()
    (tmp_path / "secret").touch()
    (own / "link").symlink_to(tmp_path / "secret")
    assert inside(own, "mesh.obj") == own / "mesh.obj"
    for name in ("../secret", "/etc/passwd", "link", "C:\\x", "a\0b"):
        with pytest.raises(ObjectError, match="it names"):
            inside(own, name)


def test_files_that_a_users_model_names_may_lie_anywhere(tmp_path: Path) -> None:
    (tmp_path / "shared").mkdir()
    (tmp_path / "mine").mkdir()
    (tmp_path / "shared" / "part.xml").write_text(model())
    path = tmp_path / "mine" / "model.xml"
    path.write_text(model('<include file="../shared/part.xml"/>'))
    check_model_file(path)
    with pytest.raises(FileError, match="it names"):
        check_model_file(path, own_folder=path.parent)


def test_a_mesh_must_be_a_regular_file(tmp_path: Path) -> None:
    path = tmp_path / "model.xml"
    path.write_text(model('<asset><mesh name="m" file="mesh"/></asset>'))
    check_model_file(path)
    (tmp_path / "mesh").mkdir()
    with pytest.raises(FileError, match="not a regular file"):
        check_model_file(path)
