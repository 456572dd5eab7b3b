"""Half-spaces of frames, and what they hold."""

from __future__ import annotations

import numpy as np
import pytest

from tests.objects.test_convex_shape import OFFSET, WEDGE, rolled
from tossid.errors import InputError
from tossid.objects.half_spaces import HalfSpaces, evenly, half_spaces, outer_hull, protrusion
from tossid.types import Toss


@pytest.fixture(scope="module")
def wedge() -> list[Toss]:
    return rolled(WEDGE + OFFSET, np.random.default_rng(0))


def test_a_half_space_holds_the_object(wedge: list[Toss]) -> None:
    spaces = half_spaces(wedge)
    reach = (spaces.down @ (WEDGE + OFFSET).T).max(axis=1)
    assert (spaces.height - reach > -1.5e-3).all()
    assert np.abs(np.linalg.norm(spaces.down, axis=1) - 1).max() < 1e-12


def test_the_outer_hull_holds_the_object_where_nothing_is_noisy() -> None:
    spaces = half_spaces(rolled(WEDGE, np.random.default_rng(1), noise=0.0))
    center, radius, vertices = outer_hull(spaces)
    inward = np.linalg.norm(vertices - center, axis=1)
    assert 0.01 < radius < inward.min()
    for corner in WEDGE:
        assert (spaces.down @ corner <= spaces.height + 1e-9).all()


def test_a_ground_far_above_fits_nothing() -> None:
    down = np.array([[0, 0, -1.0], [0, 0, 1.0]])
    spaces = HalfSpaces(
        down, np.array([-0.1, -0.1]), np.zeros((2, 2)), np.zeros(2, dtype=np.int64), np.zeros(2, dtype=bool)
    )
    with pytest.raises(InputError, match="no shape fits"):
        outer_hull(spaces)


def test_protrusion_is_the_distance_from_a_hull() -> None:
    assert protrusion(np.array([0.0, 0.0, -0.1]), WEDGE) == pytest.approx(0.07)
    assert protrusion(np.zeros(3), WEDGE) == pytest.approx(0, abs=1e-9)


def test_frames_are_drawn_evenly() -> None:
    assert np.flatnonzero(evenly(9, 3)).tolist() == [0, 4, 8]
    assert evenly(4, 10).all()
