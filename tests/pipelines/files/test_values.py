"""Values that nothing tossed has end in one clear line, wherever they enter."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import tossid
from tests.pipelines.files.test_references import MODEL, refused
from tests.store.makers import make_dataset
from tossid.errors import ConfigError, MotionError, ObjectError
from tossid.models import TrainedModel, build_model, variant
from tossid.objects import ObjectModel, load_object
from tossid.physics.system import make_system
from tossid.settings.training import TrainSettings
from tossid.store import write_dataset

__all__ = ["refused"]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda toss: toss["v"].__setitem__((3, 0), 1e300), "frame 3: v is 1e+300, expected at most 1e+06"),
        (lambda toss: toss["q"].__setitem__((3, 0), 1e300), "frame 3: q is 1e+300, expected at most 10000"),
        (lambda toss: toss["t"].__setitem__(-1, 1e300), "time is 1e+300, expected at most 1e+12"),
        (lambda toss: toss["t"].__setitem__(-1, 1e11), "time spans 1e+11 s, expected at most 1e+07 s"),
        (lambda toss: toss["q_cov"].__setitem__((2, 0, 0), 1e300), "frame 2: q_cov is larger than 1e+20"),
    ],
)
@pytest.mark.parametrize("command", [["train"], ["diagnose", "sim=nominal"]], ids=["train", "diagnose"])
def test_a_dataset_holds_values_that_can_be(
    project: Path, refused: Callable[..., str], change: Callable[[Any], None], says: str, command: list[str]
) -> None:
    write_dataset(make_dataset(load_object("cube")), "a.h5")
    with h5py.File("a.h5", "a") as file:
        change(file["tosses/toss_0000"])
    said = refused(*command, "data=a.h5")
    assert says in said
    assert "a.h5, /tosses/toss_0000" in said


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (
            ["train", "data=a.h5", "model.gravity=1e300"],
            "model.gravity: 1e+300 is out of range; expected a number from",
        ),
        (["diagnose", "data=a.h5", "sim.gravity=1e300"], "sim.gravity: 1e+300 is out of range"),
        (["synthesize", "gravity=1e300"], "gravity: 1e+300 is out of range"),
        (["synthesize", "object.friction=1e300"], "object.friction: 1e+300 is out of range"),
        (["synthesize", "object.restitution=50"], "object.restitution: 50 is out of range"),
        (["new-object", "name=a", "box=[0.1,0.1,0.1]", "mass=1e300"], "mass: 1e+300 is out of range"),
        (["new-object", "name=a", "box=[0.1,0.1,1e300]", "mass=1"], "1e+300 is out of range"),
    ],
)
def test_keys_have_values_that_can_be(project: Path, refused: Callable[..., str], words: list[str], says: str) -> None:
    write_dataset(make_dataset(load_object("cube")), "a.h5")
    assert says in refused(*words)


def test_a_mass_is_finite(project: Path, refused: Callable[..., str]) -> None:
    inertial = '<inertial pos="0 0 0" mass="{mass}" diaginertia="1 1 1"/>'
    for mass in ("inf", "1e300"):
        text = MODEL.format(head="").replace("<freejoint/>", f"<freejoint/>{inertial.format(mass=mass)}")
        (project / "heavy.xml").write_text(text)
        said = refused("synthesize", "object=custom", "object.name=a", f"object.path={project}/heavy.xml")
        assert "mass" in said or "heavy.xml" in said


@pytest.mark.parametrize(
    "changes",
    [
        {"friction": -0.1},
        {"friction": np.nan},
        {"friction": 1e300},
        {"restitution": 50.0},
        {"mass": np.array([np.inf])},
        {"mass": np.array([-1.0])},
        {"com": np.full((1, 3), np.nan)},
        {"width": np.inf},
    ],
)
def test_the_librarys_constructors_hold_the_same_limits(cube: ObjectModel, changes: dict[str, Any]) -> None:
    (name,) = changes
    with pytest.raises(ObjectError, match=name):
        replace(cube, **changes)
    if name == "friction":
        with pytest.raises(ObjectError, match=name):
            make_system(cube, friction=changes[name])


def test_the_librarys_verbs_hold_the_same_limits(cube: ObjectModel) -> None:
    dataset = make_dataset(cube)
    for gravity in (1e300, np.nan, np.inf):
        with pytest.raises(ConfigError, match=r"gravity: .* (is out of range|will not do)"):
            tossid.train(dataset, gravity=gravity)
        with pytest.raises(ObjectError, match="gravity is"):
            make_system(cube, gravity=gravity)
    toss = dataset.tosses[0]
    with pytest.raises(MotionError, match="v is 1e"):
        replace(toss, v=np.full_like(toss.v, 1e300))


def test_a_toss_may_have_any_name_in_figures(made: Path, project: Path, answer: Any) -> None:
    """Matplotlib would read what stands between two dollars as mathematics."""
    dataset = tossid.read_dataset(made / "tosses" / "tosses.h5")
    tosses = tuple(replace(toss, name=rf"a$\x${i}") for i, toss in enumerate(dataset.tosses))
    write_dataset(replace(dataset, tosses=tosses), "a.h5")
    run = next((made / "outputs" / "train").glob("*/checkpoint.pt")).parent
    assert answer("evaluate", f"run={run}", "data=a.h5")["n_tosses"] > 0


def test_a_body_of_any_name_cannot_place_files_elsewhere(
    made: Path, project: Path, refused: Callable[..., str]
) -> None:
    (project / "odd.urdf").write_text(
        '<robot name="odd"><link name="../x"><inertial><origin xyz="0 0 0"/><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
        '<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link></robot>'
    )
    odd = load_object(project / "odd.urdf")
    settings = TrainSettings(model=variant("cn"))
    shutil.copytree(next((made / "outputs" / "train").glob("*/checkpoint.pt")).parent, "run")
    TrainedModel(build_model(settings.model, odd), settings, {}).save("run/checkpoint.pt")
    said = refused("export", "run=run", "format=urdf", "out=a/b/odd.urdf")
    assert "'../x'" in said
    assert not list(project.rglob("*.obj"))
