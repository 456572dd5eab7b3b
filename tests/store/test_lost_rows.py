"""Rows in which a tracker had lost the object, in each of the ways that trackers write it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from tossid.rotations import quat_exp, wxyz_to_xyzw
from tossid.store.lost_rows import NO_NUMBER, REPEATED, ZERO, lost_rows

Array = NDArray[np.float64]
T = np.arange(60) / 148.0


def thrown(*, decimals: int = 9) -> Array:
    """A tumbling flight of 0.27 s, and rest to the last digit."""
    fly = np.minimum(T, 0.27)[:, None]
    place = np.array([0.1, -0.2, 0.4]) + fly * [1.0, 0.5, 0.4] - 0.5 * 9.81 * fly**2 * [0, 0, 1]
    quat = quat_exp(fly * np.array([3.0, -7.0, 2.0]) + np.array([0.2, 0.1, 0.4]))
    return np.round(np.concatenate([place, wxyz_to_xyzw(quat)], axis=1), decimals)


def _with(rows: slice, value: float | list[float]) -> Callable[[Array], None]:
    def put(poses: Array) -> None:
        poses[rows] = value

    return put


def _held(poses: Array) -> None:
    poses[11:15] = poses[10]


@pytest.mark.parametrize(
    ("harm", "kind", "rows"),
    [
        (_with(slice(7, 10), np.nan), NO_NUMBER, [7, 8, 9]),
        (_with(slice(0, 2), np.inf), NO_NUMBER, [0, 1]),
        (_with(slice(20, 22), 0.0), ZERO, [20, 21]),
        (_with(slice(58, 60), [0, 0, 0, 0, 0, 0, 1]), ZERO, [58, 59]),
        (_with(slice(30, 31), [0, 0, 0, 1, 0, 0, 0]), ZERO, [30]),
        (_held, REPEATED, [11, 12, 13, 14]),
    ],
)
def test_lost_frames(harm: Callable[[Array], None], kind: str, rows: list[int]) -> None:
    poses = thrown()
    harm(poses)
    gone, lost = lost_rows(T, poses)
    assert np.flatnonzero(gone).tolist() == rows
    assert lost.by_kind == {kind: len(rows)}
    assert lost.words() == f"{len(rows)} of 60 rows hold no pose ({len(rows)} {kind})"


@pytest.mark.parametrize("decimals", [9, 3, 2])
def test_rest_and_few_digits_are_no_loss(decimals: int) -> None:
    gone, lost = lost_rows(T, thrown(decimals=decimals))
    assert not gone.any()
    assert lost.words() is None


def test_a_motion_that_starts_at_the_origin_is_none() -> None:
    poses = np.zeros((60, 7))
    poses[:, 0], poses[:, 6] = 2.0 * T, 1.0
    assert not lost_rows(T, poses)[0].any()


def test_a_tracker_slower_than_its_file_repeats_every_other_row() -> None:
    poses = thrown()
    poses[1::2] = poses[::2]
    gone, _ = lost_rows(T, poses)
    assert gone[:39].sum() > 15
