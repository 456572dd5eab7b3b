"""Possible contact from poses alone: what straight-line extrapolation of the corners reaches."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.motion.contact import lowest_corner, may_touch
from tossid.objects import ObjectModel


def _heights(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    q = np.zeros((len(z), 7))
    q[:, 2], q[:, 3] = z, 1.0
    return np.arange(len(z)) / 100, q


def test_the_lowest_corner_is_half_a_width_below_a_level_cube(cube: ObjectModel) -> None:
    assert lowest_corner(cube, _heights(np.array([0.3]))[1])[0] == pytest.approx(0.3 - 0.5 * cube.width)


def test_an_impact_between_two_clear_frames_is_possible_contact(cube: ObjectModel) -> None:
    """Falls to 2 cm above the ground and is as high again a frame later: at 4 m/s it has touched between."""
    clear = 0.5 * cube.width + np.array([0.10, 0.06, 0.02, 0.02, 0.06, 0.10])
    np.testing.assert_array_equal(may_touch(cube, *_heights(clear)), [False, False, True, False, False])


def test_a_slow_hover_is_no_contact(cube: ObjectModel) -> None:
    assert not may_touch(cube, *_heights(np.full(6, 0.5 * cube.width + 0.02))).any()


def test_motions_that_follow_one_another_are_judged_each_for_itself(cube: ObjectModel) -> None:
    falls = 0.5 * cube.width + np.array([0.10, 0.06, 0.02, 0.02, 0.06, 0.10])
    t, q = _heights(np.concatenate([falls, falls[:2], falls]))
    alone = [may_touch(cube, *_heights(each)) for each in (falls, falls[:2], falls)]
    expected = np.concatenate([alone[0], [False], alone[1], [False], alone[2]])
    np.testing.assert_array_equal(may_touch(cube, t % 0.06, q, np.array([0, 6, 8])), expected)
