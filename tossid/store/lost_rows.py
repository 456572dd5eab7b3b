"""Rows of a tracker's file that hold no pose, because it had lost the object."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

NO_NUMBER = "not finite"
ZERO = "of zeros"
REPEATED = "the pose before again while it moves"
_APART = 0.03
"""Distance to the nearest pose from which on the origin is no place of the object, but stands for none [m],
if it is also so many steps, as they are in the median."""
_STEPS = 3
_MOVING = 0.1
"""Speed above which a tracked pose does not stay the same to the last digit [m/s]."""
_DIGITS = 3
"""Steps smaller than so many last digits of a file are no motion."""


@dataclass
class Lost:
    """How many rows of some files hold no pose.

    Attributes:
        rows: Rows of all of them.
        by_kind: Of these, rows without a pose, by what they hold instead.
    """

    rows: int
    by_kind: Counter[str]

    def words(self) -> str | None:
        """How many there are, in words; None if there are none."""
        return (
            f"{self.by_kind.total()} of {self.rows} rows hold no pose ({_kinds(self.by_kind)})"
            if self.by_kind
            else None
        )


def _kinds(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {kind}" for kind, count in counts.items())


def lost_rows(t: Array, poses: Array) -> tuple[Bools, Lost]:
    """Which rows hold no pose: not a number, zeros, or the last pose again although the object moves.

    Args:
        t: Times (n,) [s].
        poses: (n, 7) positions [m] and quaternions x, y, z, w; not finite where the file has none.

    Returns:
        (n,) true where there is none, and their counts.
    """
    nothing = np.asarray(~np.isfinite(poses).all(axis=1))
    zero = ~nothing & _zeros(poses, ~nothing)
    good = np.flatnonzero(~(nothing | zero))
    again = np.zeros(len(t), dtype=bool)
    again[good[_held(t[good], poses[good])]] = True
    kinds = {NO_NUMBER: nothing, ZERO: zero, REPEATED: again}
    counts = Counter({kind: int(where.sum()) for kind, where in kinds.items() if where.any()})
    return nothing | zero | again, Lost(len(t), counts)


def _zeros(poses: Array, given: Bools) -> Bools:
    """Rows whose quaternion is 0, or that are at the origin, unturned, though poses beside them are far from it."""
    at_origin = given & (poses[:, :3] == 0).all(axis=1)
    no_turn = (poses[:, 3:] == 0).all(axis=1)
    unturned = at_origin & (poses[:, 3:6] == 0).all(axis=1) & (np.abs(poses[:, 6]) == 1)
    # a wxyz file has its 1 in the first place
    unturned |= at_origin & (poses[:, 4:] == 0).all(axis=1) & (np.abs(poses[:, 3]) == 1)
    others = np.flatnonzero(given & ~unturned & ~no_turn)
    if not len(others):
        return given & no_turn
    steps = np.linalg.norm(np.diff(poses[others, :3], axis=0), axis=1)
    apart = max(_APART, _STEPS * float(np.median(steps))) if len(steps) else _APART
    for row in np.flatnonzero(unturned):
        after = int(np.searchsorted(others, row))
        beside = others[max(after - 1, 0) : after + 1]
        unturned[row] = np.linalg.norm(poses[beside, :3], axis=1).min() > apart
    return (given & no_turn) | unturned


def _held(t: Array, poses: Array) -> NDArray[np.int64]:
    """Rows that repeat the one before them to the last digit, between steps of a moving object."""
    if len(t) < 4:
        return np.zeros(0, dtype=np.int64)
    step, size = np.diff(poses, axis=0), np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1)
    same = (step == 0).all(axis=1)
    digits = np.abs(step[:, :3])
    least = _DIGITS * float(digits[digits > 1e-12].min(initial=np.inf))
    with np.errstate(divide="ignore", invalid="ignore"):
        moves = (size / np.diff(t) > _MOVING) & (size > least)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same, [0]]).astype(int)))
    runs = [
        np.arange(first + 1, last + 1)
        for first, last in zip(edges[::2], edges[1::2], strict=True)
        if first > 0 and last < len(same) and moves[first - 1] and moves[last]
    ]
    return np.concatenate(runs) if runs else np.zeros(0, dtype=np.int64)
