"""Base parameters: as many as theory has, and what they leave out moves nothing."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.trees import random_tree
from tossid.objects import OBJECT_FILES, ObjectModel, load_object
from tossid.physics import make_system, tree_batch
from tossid.physics.batch import mass_matrices
from tossid.physics.identifiable import base_parameters, inertia_error, inertial_parameters


def mass_matrix(model: ObjectModel, q: np.ndarray) -> np.ndarray:
    system = make_system(model)
    return np.asarray(mass_matrices(tree_batch(system, q[None], np.zeros((1, model.nv))), system)[0])


def test_a_single_body_has_ten_and_a_hinge_takes_three_away() -> None:
    cube, elbow = (load_object(OBJECT_FILES / f"{name}.xml") for name in ("cube", "elbow"))
    assert len(base_parameters(cube).names) == 10
    assert len(base_parameters(elbow).names) == 17
    rng = np.random.default_rng(0)
    hinged = random_tree(rng, n_bodies=3, slides=False)
    assert len(base_parameters(hinged).names) == 24


def test_mass_on_the_hinge_s_axis_belongs_to_either_link() -> None:
    elbow = load_object(OBJECT_FILES / "elbow.xml")
    base = base_parameters(elbow)
    assert base.names[0] == "elbow_1.m + 1 elbow_2.m"
    # a point of 0.1 kg on the axis, 2 cm along it, moves from the second link to the first
    m, at = 0.1, np.array([0, 0.02, 0])
    moved = []
    for b, (sign, where) in enumerate(((1, elbow.body_pos[1] + at), (-1, at))):
        mass = elbow.mass[b] + sign * m
        com = (elbow.mass[b] * elbow.com[b] + sign * m * where) / mass
        about = lambda x: x @ x * np.eye(3) - np.outer(x, x)  # noqa: E731
        inertia = elbow.inertia[b] + elbow.mass[b] * about(elbow.com[b]) + sign * m * about(where) - mass * about(com)
        moved.append((mass, com, inertia))
    other = elbow.with_changes(
        **{
            name: np.array(part)
            for name, part in zip(("mass", "com", "inertia"), zip(*moved, strict=True), strict=True)
        }
    )
    np.testing.assert_allclose(base.errors(other, elbow), 0, atol=1e-9)
    rng = np.random.default_rng(1)
    for _ in range(5):
        q = rng.normal(size=8)
        q[3:7] /= np.linalg.norm(q[3:7])
        np.testing.assert_allclose(mass_matrix(other, q), mass_matrix(elbow, q), atol=1e-12)


def test_equal_base_parameters_are_equal_mass_matrices() -> None:
    rng = np.random.default_rng(2)
    model = random_tree(rng, n_bodies=4)
    base = base_parameters(model)
    whole = inertial_parameters(model)
    assert np.linalg.matrix_rank(base.rows) == len(base.names)
    heavier = model.with_changes(mass=2 * model.mass, inertia=2 * model.inertia)
    np.testing.assert_allclose(base.values(heavier), base.values(model))
    np.testing.assert_allclose(base.rows @ whole / model.mass.sum(), base.values(model))


def test_no_combination_has_large_factors_where_a_hinge_is_nearly_along_an_axis() -> None:
    """A tracker's frame: the axis is 0.003 degrees from y, and the origin is off it."""
    elbow = load_object(OBJECT_FILES / "elbow.xml")
    axis = np.array([4e-5, 1.0, -4e-5])
    tracked = elbow.with_changes(
        joint_axis=np.array([np.zeros(3), axis / np.linalg.norm(axis)]),
        joint_pos=np.array([np.zeros(3), [0.01, -0.043, -0.02]]),
    )
    base = base_parameters(tracked)
    assert len(base.names) == 17
    assert np.abs(base.rows).max() < 10


def test_error_of_inertia_is_that_of_the_kinetic_energy() -> None:
    elbow = load_object(OBJECT_FILES / "elbow.xml")
    assert inertia_error(elbow, elbow) < 1e-12
    # about the line through both centres of mass, nothing else turns
    assert inertia_error(elbow.with_changes(inertia=1.04 * elbow.inertia), elbow) == pytest.approx(0.04)
    cube = load_object(OBJECT_FILES / "cube.xml")
    assert inertia_error(cube.with_changes(inertia=1.3 * cube.inertia), cube) == pytest.approx(0.3)
