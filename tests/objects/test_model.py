"""Values of an object: what cannot be is refused, sizes follow from bodies; boxes, and objects that are not stated."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest

from tossid.errors import ConfigError, InputError, ObjectError
from tossid.objects import (
    JointLaw,
    ObjectModel,
    body_poses,
    box,
    free_joints,
    load_object,
    need_stated,
    object_from_mjcf,
    unstated_object,
)
from tossid.objects.unstated import hinge_of


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


def test_it_has_the_inertia_of_a_solid_box() -> None:
    edges = np.array([0.2, 0.1, 0.06])
    model = box("brick", edges, 0.5, friction=0.3)
    # the second moments of points that fill it evenly
    axis = (np.arange(60) + 0.5) / 60 - 0.5
    points = np.array(list(product(axis, axis, axis))) * edges
    inertia = 0.5 * np.mean((points**2).sum(axis=1)) * np.eye(3) - 0.5 * points.T @ points / len(points)
    np.testing.assert_allclose(model.inertia[0], inertia, rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(np.ptp(model.corner_pos, axis=0), edges, rtol=1e-12)
    assert (model.mass.item(), model.friction, model.width) == (0.5, 0.3, 0.2)


def test_its_centre_of_mass_may_lie_elsewhere_inside() -> None:
    assert box("brick", (0.2, 0.1, 0.06), 0.5, com=(0.02, 0, -0.01)).com[0].tolist() == [0.02, 0, -0.01]


@pytest.mark.parametrize(
    ("changes", "says"),
    [({"com": (0.2, 0, 0)}, "com: .* lies outside the box"), ({"name": "a b"}, "name: 'a b' will not do")],
)
def test_what_is_no_box_is_said(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        box(**{"name": "brick", "edges": (0.2, 0.1, 0.06), "mass": 0.5, **changes})


def test_it_is_one_rigid_body_without_a_shape() -> None:
    model = unstated_object(com=(0.01, 0.0, 0.0), gyration=0.03)
    assert (model.nq, model.nv, model.n_corners) == (7, 6, 0)
    assert not model.is_stated
    assert model.center.tolist() == [0.0, 0.0, 0.0]
    assert not load_object("unknown").is_stated


def test_two_links_have_a_hinge_and_no_shape(elbow: ObjectModel) -> None:
    hinge = hinge_of(elbow)
    model = unstated_object(hinge=hinge)
    assert (model.nq, model.nv, model.n_corners, model.mass.sum()) == (8, 7, 0, 1.0)
    q = np.array([0.1, 0.2, 0.3, 0.5, 0.5, -0.5, 0.5, 1.2])
    for one, other in zip(body_poses(model, q), body_poses(elbow, q), strict=True):
        assert one == pytest.approx(other)
    assert hinge_of(unstated_object()) is None
    slide = elbow.with_changes(joint_type=np.array([0, 2]))
    with pytest.raises(InputError, match="two links on a hinge"):
        hinge_of(slide)


def test_what_needs_a_shape_says_so(cube: ObjectModel) -> None:
    need_stated(cube, "a diagnosis")
    with pytest.raises(InputError, match="a diagnosis needs a stated object"):
        need_stated(unstated_object(), "a diagnosis")
