"""Values that nothing tossed has end in one clear line, wherever they enter."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tossid
from tests.store.makers import make_dataset
from tossid.errors import ConfigError, MotionError, ObjectError
from tossid.objects import ObjectModel
from tossid.physics.system import make_system
from tossid.store import write_dataset


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
    run = next((made / "outputs" / "train").iterdir())
    assert answer("evaluate", f"run={run}", "data=a.h5")["n_tosses"] > 0
