"""Random starts, and how far apart trainings end."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from experiments.random_starts import end_difference, random_starts
from tossid.models import TrainedModel
from tossid.models.random_start import FRICTION, INERTIA
from tossid.objects import GRAVITY, ObjectModel, object_from_mjcf


def test_starts_lie_in_their_ranges(cube: ObjectModel) -> None:
    starts = random_starts(cube, 40, seed=2)
    assert [start.corners for start in starts[:4]] == ["ball", "offset"] * 2
    assert {(start.corners, start.gravity) for start in starts} == {
        (kind, gravity) for kind in ("ball", "offset") for gravity in (0.0, GRAVITY)
    }
    ball = np.concatenate([start.object.corner_pos for start in starts[::2]])
    assert 0.15 < np.linalg.norm(ball, axis=1).max() <= 0.2
    off = np.concatenate([start.object.corner_pos - cube.corner_pos for start in starts[1::2]])
    assert off.std() == pytest.approx(0.4 * 0.5 * cube.width, rel=0.1)
    for values, (low, high) in (
        ([start.object.friction for start in starts], FRICTION),
        ([start.inertia_rel for start in starts], INERTIA),
    ):
        assert low <= min(values) < 2 * low
        assert 0.5 * high < max(values) <= high
    np.testing.assert_allclose(starts[3].object.inertia, starts[3].inertia_rel * cube.inertia)


def test_a_model_that_is_given_inertia_and_gravity_keeps_them(cube: ObjectModel) -> None:
    for start in random_starts(cube, 4, continuous=False):
        assert (start.gravity, start.inertia_rel) == (GRAVITY, 1.0)
        np.testing.assert_array_equal(start.object.inertia, cube.inertia)


def test_the_same_seed_draws_the_same_and_the_file_has_the_corners(cube: ObjectModel) -> None:
    one, two = (random_starts(cube, 3, seed=5)[2] for _ in range(2))
    np.testing.assert_array_equal(one.object.corner_pos, two.object.corner_pos)
    again = object_from_mjcf(one.object.mjcf, name="cube")
    np.testing.assert_allclose(np.sort(again.corner_pos, axis=0), np.sort(one.object.corner_pos, axis=0), atol=1e-6)


def test_ends_are_compared_both_ways_over_what_was_seen(cube: ObjectModel) -> None:
    def trained(corners: np.ndarray, seen: list[bool], friction: float) -> TrainedModel:
        parameters: dict[str, Any] = {"geometry": [{"vertices_m": corners.tolist(), "seen": seen}]}
        found = SimpleNamespace(parameters=parameters, object=cube.with_changes(friction=friction))
        return cast(TrainedModel, found)

    whole = trained(cube.corner_pos, [True] * 8, 0.18)
    fewer = trained(cube.corner_pos[:7], [True] * 7, 0.2)
    assert end_difference(whole, whole) == (0.0, 0.0)
    for one, two in ((whole, fewer), (fewer, whole)):
        end = end_difference(one, two)
        assert end.corners == pytest.approx(cube.width)
        assert end.friction == pytest.approx(0.02)
    moved = cube.corner_pos.copy()
    moved[0] += 0.05
    assert end_difference(whole, trained(moved, [False] + [True] * 7, 0.18)).corners == pytest.approx(cube.width)
    extra = trained(np.vstack([cube.corner_pos, [[0.0, 0.0, 0.0]]]), [True] * 8 + [False], 0.18)
    assert end_difference(whole, extra).corners == 0.0
