"""An object as a dataset carries it: its text gives the very arrays back, and reaches no other file."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tossid.errors import ObjectError
from tossid.objects import ObjectModel, object_from_mjcf
from tossid.store.object_text import model_of_text, text_of_model

VALUES: dict[str, Any] = {
    "name": "thing",
    "friction": 0.3,
    "restitution": 0.1,
    "compliance": 0.0,
    "relaxation": 0.0,
    "cohesion": 0.0,
    "width": 0.1,
    "tags": None,
}


def test_a_text_that_is_current_is_kept(elbow: ObjectModel) -> None:
    assert text_of_model(elbow) == elbow.mjcf


def test_a_text_that_is_out_of_date_is_written_anew(cube: ObjectModel) -> None:
    heavy = cube.with_changes(mass=2 * cube.mass)
    text = text_of_model(heavy)
    assert text != heavy.mjcf
    np.testing.assert_allclose(object_from_mjcf(text).mass, heavy.mass)


def test_what_the_text_cannot_say_comes_beside(cube: ObjectModel) -> None:
    model = model_of_text(cube.mjcf, **VALUES)
    assert (model.name, model.friction, model.restitution, model.width) == ("thing", 0.3, 0.1, 0.1)


@pytest.mark.parametrize(
    ("text", "changes", "says"),
    [
        ('<mujoco><include file="other.xml"/></mujoco>', {}, "names another file"),
        ("<mujoco><extension/></mujoco>", {}, "element <extension>"),
        ("", {"friction": -0.1}, "cannot be"),
        ("", {"width": 0.0}, "cannot be"),
    ],
)
def test_what_is_hostile_or_cannot_be_is_refused(
    cube: ObjectModel, text: str, changes: dict[str, Any], says: str
) -> None:
    with pytest.raises(ObjectError, match=says):
        model_of_text(text or cube.mjcf, **VALUES | changes)


def test_an_object_without_a_text_of_its_own_is_described(cube: ObjectModel) -> None:
    assert object_from_mjcf(text_of_model(replace(cube, mjcf=""))).n_corners == 8
