"""An object refuses numbers that cannot be, and knows its sizes."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.errors import ObjectError
from tossid.objects import JointLaw, ObjectModel, free_joints, object_from_mjcf


@pytest.mark.parametrize("name", ["compliance", "relaxation", "cohesion"])
def test_a_contact_law_that_cannot_be_is_refused(cube: ObjectModel, name: str) -> None:
    assert getattr(object_from_mjcf(cube.mjcf, **{name: 0.01}), name) == 0.01
    for value in (-1e-9, float("nan"), float("inf")):
        with pytest.raises(ObjectError, match=name):
            cube.with_changes(**{name: value})


def test_sizes_follow_from_the_bodies(cube: ObjectModel, elbow: ObjectModel) -> None:
    assert (cube.n_bodies, cube.n_joints, cube.nq, cube.nv, cube.n_corners) == (1, 0, 7, 6, 8)
    assert (elbow.n_bodies, elbow.n_joints, elbow.nq, elbow.nv, elbow.n_corners) == (2, 1, 8, 7, 16)


def test_the_centre_is_that_of_the_bases_corners(elbow: ObjectModel) -> None:
    shift = np.array([0.01, 0, 0])
    moved = np.where((elbow.corner_body == 0)[:, None], elbow.corner_pos + shift, elbow.corner_pos + 1.0)
    np.testing.assert_allclose(elbow.with_changes(corner_pos=moved).center, elbow.center + shift)


def test_joints_act_only_where_a_number_says_so(elbow: ObjectModel) -> None:
    assert not elbow.joints.acts
    assert not free_joints(2)._replace(rest=np.ones(2)).acts
    assert free_joints(2)._replace(damping=np.array([0.0, 0.1])).acts


@pytest.mark.parametrize("part", ["damping", "friction", "stiffness", "armature"])
def test_a_joint_law_that_cannot_be_is_refused(elbow: ObjectModel, part: str) -> None:
    for values in (np.array([0.0, -1.0]), np.array([0.0, np.nan]), np.zeros(3)):
        with pytest.raises(ObjectError, match=part):
            elbow.with_changes(joint_law=JointLaw(**{**free_joints(2)._asdict(), part: values}))
