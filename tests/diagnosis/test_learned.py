"""A learned acceleration is named by the effects that do the same in flight, and by no others."""

from __future__ import annotations

import numpy as np
import pytest

from tests.models.made import tosses
from tossid.diagnosis.learned import LearnedForces, learned_forces
from tossid.objects import ObjectModel
from tossid.physics import LearnedAcceleration, n_features
from tossid.physics.effects import World, effects_for
from tossid.types import Toss

NF = n_features(0, world=True)


def field(constant: np.ndarray, place: np.ndarray, velocity: np.ndarray, spin: float = 0.0) -> LearnedAcceleration:
    """A learned acceleration that is linear in the place, the velocity and the spin."""
    linear = np.zeros((9, NF))
    linear[6:, -7], linear[6:, -6:-3], linear[6:, -3:] = constant, place, velocity
    linear[3:6, 6:9] = 10 * spin * np.eye(3)
    return LearnedAcceleration(linear, np.zeros((0, NF)), np.zeros(0), np.zeros((0, 0)), np.zeros(0), np.zeros((9, 0)))


@pytest.fixture(scope="module")
def flights(cube: ObjectModel) -> list[Toss]:
    made = tosses(cube, 4, seed=5, frames=24)
    shift = np.random.default_rng(0).normal(size=(4, 2))
    for toss, (x, y) in zip(made, shift, strict=True):
        toss.q[:, :2] += [x, y]
    return made


def found_in(
    cube: ObjectModel, flights: list[Toss], k_res: LearnedAcceleration, gravity: float = 9.81
) -> LearnedForces:
    return learned_forces(World(cube, gravity=gravity, k_res=k_res), flights, effects_for(cube))


NO = np.zeros((3, 3))
SWIRL = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])


def test_fields_are_named_with_their_values(cube: ObjectModel, flights: list[Toss]) -> None:
    m = 0.37
    centre = np.array([0.2, -0.1, 0.3])
    cases = {
        "vortex": (field(np.zeros(3), 3.0 / m * SWIRL, NO), {"c_npm": 3.0}),
        "linear_drag": (field(np.zeros(3), NO, -0.3 / m * np.eye(3)), {"c_nspm": 0.3}),
        "uniform_force": (field(np.array([0.8, -0.5, 0.2]) / m, NO, NO), {"x_n": 0.8, "y_n": -0.5, "z_n": 0.2}),
        "position_force": (
            field(3.0 / m * centre, -3.0 / m * np.eye(3), NO),
            {"k_npm": 3.0, "x_m": 0.2, "y_m": -0.1, "z_m": 0.3},
        ),
    }
    for name, (k_res, values) in cases.items():
        found = found_in(cube, flights, k_res)
        assert [effect.name for effect in found.stands_for] == [name]
        assert found.stands_for[0].parameters == pytest.approx(values, rel=0.01)
        assert found.unexplained_share < 1e-3
    found = found_in(cube, flights, field(np.array([0.0, 0.0, -5.81]), NO, NO), gravity=4.0)
    assert [(e.name, round(e.parameters["g_ms2"], 2)) for e in found.stands_for] == [("gravity", 9.81)]


def test_two_forces_are_two_names(cube: ObjectModel, flights: list[Toss]) -> None:
    inertia = float(cube.inertia[0, 0, 0])
    both = found_in(cube, flights, field(np.zeros(3), 3.0 / 0.37 * SWIRL, NO, spin=-1e-2 / inertia))
    assert {effect.name for effect in both.stands_for} == {"vortex", "spin_drag"}
    assert sum(effect.share for effect in both.stands_for) == pytest.approx(1 - both.unexplained_share)


def test_what_is_small_or_no_force_has_no_name(cube: ObjectModel, flights: list[Toss]) -> None:
    small = found_in(cube, flights, field(np.array([0.01, 0.0, 0.0]), NO, NO))
    assert small.small
    assert not small.stands_for
    shear = np.array([[0.0, 0.0, 4.0], [0.0, 0.0, 0.0], [4.0, 0.0, 0.0]])
    other = found_in(cube, flights, field(np.zeros(3), shear - np.diag([3.0, 0.0, -3.0]), NO))
    assert other.unexplained_share > 0.3
    assert learned_forces(World(cube), flights, effects_for(cube)) is None
