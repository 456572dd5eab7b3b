"""When each row of an image is exposed, and where things are then."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.rotations import quat_boxminus, quat_exp, quat_mul

Array = NDArray[np.float64]

FINEST = 400
"""Most sub-exposures of an image."""


@dataclass(frozen=True, eq=False)
class Exposure:
    """Where things are while an image is exposed.

    Attributes:
        q: (k, nq) configurations in the middles of k equal parts of the time from the first row's opening to the last
            row's closing.
        rows: Sub-exposures from one row to the next, and those that one row's exposure lasts.
        hand: (k, 7) pose of the hand, NaN where there is none; None: never.
    """

    q: Array
    rows: tuple[float, float]
    hand: Array | None = None


@dataclass(frozen=True, slots=True)
class Shutter:
    """When each row of an image is exposed.

    A frame's time is the middle of the exposure of the image's middle row: row r of h has its own middle
    line (r - (h - 1) / 2) later.

    Attributes:
        exposure: How long each row is exposed [s].
        line: Time from one row's exposure to the next row's [s]; 0 for all at once.
    """

    exposure: float = 0.001
    line: float = 0.0

    def lasts(self, height: int) -> float:
        """The time from the first row's opening to the last row's closing [s]."""
        return self.exposure + self.line * (height - 1)

    def check(self, height: int, period: float) -> None:
        """`InputError` unless an image is read before the next one begins."""
        if self.exposure < 0 or self.line < 0 or self.lasts(height) > period * (1 + 1e-9):
            raise InputError(
                f"exposure is {self.exposure} s and {height} rows follow each other by {self.line} s, expected both "
                f"together to be 0 to the time between frames ({period:.6g} s)"
            )

    def expose(self, t: Array, q: Array, i: int, height: int, samples: int, hand: Array | None = None) -> Exposure:
        """A motion as frame i sees it; between frames' times it is interpolated.

        Args:
            t: (n,) times of the frames [s].
            q: (n, nq) configurations then.
            i: The frame.
            height: Rows of the image.
            samples: Rays a pixel.
            hand: (n, 7) poses of the hand; None for no hand.

        Returns:
            Where things are while the frame is exposed.
        """
        if self.line == 0:
            parts, span = samples, float(samples)
        else:
            share = self.exposure / self.lasts(height)
            parts = int(np.clip(np.ceil(samples / max(share, 1e-9)), samples, FINEST))
            span = share * parts
        duration = self.lasts(height)
        times = t[i] + duration * ((np.arange(parts) + 0.5) / parts - 0.5)
        seen = None if hand is None else poses_at(t, hand, times)
        if seen is not None and not np.isfinite(seen).any():
            seen = None
        path = poses_at(t, q, times)
        if seen is None and (path == path[0]).all():
            return Exposure(path[:1], (0.0, 1.0))
        return Exposure(path, ((parts - span) / max(height - 1, 1), span), seen)


def interpolate(q0: Array, q1: Array, s: Array) -> Array:
    """Configurations between two, at shares s of the way: straight positions and joints, shortest turn.

    (*b, nq), (*b, nq), (*b) -> (*b, nq).
    """
    q0, q1 = np.asarray(q0, dtype=float), np.asarray(q1, dtype=float)
    share = np.asarray(s, dtype=float)[..., None]
    q = q0 + share * (q1 - q0)
    q[..., 3:7] = quat_mul(q0[..., 3:7], quat_exp(share * quat_boxminus(q1[..., 3:7], q0[..., 3:7])))
    return q


def poses_at(t: Array, q: Array, times: Array) -> Array:
    """A motion at any times, interpolated between its samples and held beyond its ends. (k,) -> (k, nq)."""
    after = np.clip(np.searchsorted(t, times, side="right"), 1, len(t) - 1)
    share = np.clip((times - t[after - 1]) / (t[after] - t[after - 1]), 0.0, 1.0)
    return interpolate(q[after - 1], q[after], share)
