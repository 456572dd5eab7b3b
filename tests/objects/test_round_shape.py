"""Round shapes that are known, from poses over the ground."""

from __future__ import annotations

import numpy as np
import pytest

from tests.objects.test_convex_shape import WEDGE, rolled
from tossid.objects.convex_shape import find_shape
from tossid.objects.round_shape import support
from tossid.objects.roundness import Roundness, ball, directions, disc, ellipsoid, joined

OFF = np.array([0.01, -0.02, 0.005])
CAPSULE = (OFF + np.array([[0, 0, -0.03], [0, 0, 0.03]]), joined([ball(0.02)] * 2))
SHAPES = {
    "ellipsoid": (OFF[None], ellipsoid([0.06, 0.045, 0.035])),
    "sphere": (OFF[None], ball(0.04)),
    "capsule": CAPSULE,
    "rounded disc": (np.tile(OFF, (3, 1)), disc(0.04, [0.2, 0.1, 1.0], edge=0.01)),
}


@pytest.mark.parametrize("kind", SHAPES)
def test_a_round_shape_is_found_as_what_it_is(kind: str) -> None:
    at, roundness = SHAPES[kind]
    ways = directions(1500)
    points = (at + roundness.offset(np.repeat(ways[:, None], len(at), axis=1))).reshape(-1, 3)
    shape = find_shape(rolled(points, np.random.default_rng(0), tosses=16))
    assert shape.kind in (kind, "rounded cylinder") if kind == "rounded disc" else shape.kind == kind
    assert np.abs(shape.reach(ways) - support(at, roundness, ways)).max() < 5e-4
    assert 0.6 < (shape.frames >= 1).mean() < 1.0  # 320 contacts do not show every side
    assert shape.mean_width == pytest.approx(2 * support(at, roundness, ways).mean(), abs=5e-4)


def test_numbers_that_a_sphere_does_not_need_cost_what_its_contacts_make_them_cost() -> None:
    """A polytope shows hardly a contact of a sphere. Priced by its contacts, other shapes won in two of four draws."""
    at, roundness = SHAPES["sphere"]
    points = at + roundness.offset(directions(1500)[:, None])[:, 0]
    assert {find_shape(rolled(points, np.random.default_rng(seed), tosses=16)).kind for seed in range(1, 4)} == {
        "sphere"
    }


def test_a_polytope_stays_one() -> None:
    assert find_shape(rolled(WEDGE, np.random.default_rng(0))).kind == "polytope"


def test_moments_are_those_of_the_filled_shape() -> None:
    at, roundness = SHAPES["ellipsoid"]
    ways = directions(1500)
    shape = find_shape(rolled(at + roundness.offset(ways[:, None])[:, 0], np.random.default_rng(1), tosses=16))
    _, com, inertia = shape.solid()
    a, b, c = np.array([0.06, 0.045, 0.035]) ** 2
    assert com == pytest.approx(OFF, abs=3e-4)
    assert np.diag(inertia) == pytest.approx(np.array([b + c, a + c, a + b]) / 5, rel=0.03)
    assert isinstance(shape.roundness, Roundness)
