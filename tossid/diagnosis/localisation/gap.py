"""The gap: how far predictions are off, in which phases and channels, and how much is left with effects in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.findings import Gap, Interval, ratio_over_tosses
from tossid.diagnosis.inference.evidence import Evidence
from tossid.diagnosis.likelihood.density import student_deviance
from tossid.diagnosis.localisation.noise import Floor
from tossid.types import Phase, Toss

Array = NDArray[np.float64]
Index = NDArray[np.int64]

PHASES = (Phase.FLIGHT, Phase.IMPACT, Phase.SLIDE, Phase.ROLL, Phase.REST)
CHANNELS = ("p_x", "p_y", "p_z", "r_x", "r_y", "r_z")
"""Of the base; those of joints are joint_1 and so on."""
LEAST_LEFT = 0.15
"""Share of the first gap that must clearly be left in a phase for it to be named as not explained."""
FAR, FAR_TOO = 8.0, 1.0
"""A toss is odd if its mean square exceeds the median by so many median deviations, and by so much more."""


@dataclass(frozen=True)
class Rows:
    """The residuals of m rows of windows, each frame of a toss once.

    Attributes:
        toss: (m,) number of the toss.
        time: (m,) since the toss began [s].
        phase: (m,) `Phase`.
        after_impact: (m,) whether an impact is earlier in the same window.
        raw: (m, K) measured minus predicted poses [m, rad].
        whitened: (m, K) the same over their standard deviations, none beyond the largest that counts.
        excess: (m, K) Student's deviance above what noise leaves.
        n: How many tosses.
    """

    toss: Index
    time: Array
    phase: NDArray[np.uint8]
    after_impact: NDArray[np.bool_]
    raw: Array
    whitened: Array
    excess: Array
    n: int

    @property
    def rms(self) -> float:
        """Root mean square of whitened residuals."""
        return float(np.sqrt((self.whitened**2).mean()))

    @property
    def position_rms(self) -> float:
        """Root mean square distance [m]."""
        return float(np.sqrt((self.raw[:, :3] ** 2).sum(1).mean()))

    @property
    def rotation_rms(self) -> float:
        """Root mean square angle [rad]."""
        return float(np.sqrt((self.raw[:, 3:6] ** 2).sum(1).mean()))

    def excess_where(self, chosen: NDArray[np.bool_]) -> Array:
        """(n,) excess of each toss in some rows.

        Args:
            chosen: (m,) which.
        """
        return self.by_toss(np.where(chosen[:, None], self.excess, 0.0))

    def by_toss(self, values: Array) -> Array:
        """(n,) sums over each toss.

        Args:
            values: (m,) or (m, K).
        """
        flat = values if values.ndim == 1 else values.sum(1)
        return np.bincount(self.toss, weights=flat, minlength=self.n).astype(float)


def rows_of(parts: Sequence[tuple[Evidence, Index]], floor: Floor) -> Rows:
    """The rows of tosses, of which each part is judged by an evidence of its own.

    Args:
        parts: Evidences, each with the numbers (m,) of the tosses that it is of.
        floor: What noise leaves.
    """
    made = []
    for evidence, numbers in parts:
        w, largest = evidence.windows, evidence.density.largest_residual
        impact = w.phase == Phase.IMPACT
        after = np.logical_or.accumulate(impact & w.inside, axis=1) & ~impact
        toss = np.broadcast_to(numbers[w.toss][:, None], w.tick.shape)
        of_rows = (
            toss,
            w.tick * w.dt,
            w.phase,
            after,
            evidence.raw,
            np.clip(evidence.residuals, -largest, largest),
            student_deviance(evidence.residuals, evidence.density) - floor.deviance,
        )
        made.append([each[w.counted] for each in of_rows])
    n = max((int(numbers.max(initial=-1)) + 1 for _, numbers in parts), default=0)
    toss, time, phase, after, raw, whitened, excess = (np.concatenate(each) for each in zip(*made, strict=True))
    return Rows(toss, time, phase, after, raw, whitened, excess, n)


def measure_gap(tosses: Sequence[Toss], rows: Rows, floor: Floor) -> Gap:
    """The gap of a hypothesis: its size, and its shares by phase and channel.

    Args:
        tosses: n, as recorded.
        rows: Of their windows.
        floor: The noise floor.
    """
    squares, count = rows.by_toss(rows.whitened**2), rows.by_toss(np.ones_like(rows.whitened))
    ratio = ratio_over_tosses(squares, count)
    total = Interval(*(float(np.sqrt(max(x, 0.0))) for x in (ratio.value, ratio.low, ratio.high)))
    whole = rows.by_toss(rows.excess)

    def share(of_tosses: Array) -> Interval:
        return ratio_over_tosses(of_tosses, whole)

    mean = squares / np.maximum(count, 1)
    middle = np.median(mean)
    far = middle + FAR * np.median(np.abs(mean - middle)) + FAR_TOO
    channels = enumerate(channels_of(rows.excess.shape[1]))
    return Gap(
        total=total,
        noise_floor=floor.rms,
        position_mm=1e3 * rows.position_rms,
        rotation_deg=float(np.rad2deg(rows.rotation_rms)),
        by_phase={phase.name.lower(): share(rows.excess_where(rows.phase == phase)) for phase in PHASES},
        by_channel={name: share(rows.by_toss(rows.excess[:, c])) for c, name in channels},
        frames=np.stack([rows.toss, rows.time, rows.phase, rows.excess.mean(1)], axis=1),
        odd=tuple(toss.name for toss, size in zip(tosses, mean, strict=True) if size > far),
        after_impacts=share(rows.excess_where(rows.after_impact)),
    )


def phases_left(before: Rows, after: Rows) -> dict[str, Interval]:
    """Phases in which clearly some of the first gap is left, with their shares of it.

    Args:
        before: Of the simulator as it is stated.
        after: With what was found.
    """
    whole = before.by_toss(before.excess)
    shares = {p.name.lower(): ratio_over_tosses(after.excess_where(after.phase == p), whole) for p in PHASES}
    return {name: share for name, share in shares.items() if share.low > 0 and share.value > LEAST_LEFT}


def is_clear(rows: Rows, phases: Sequence[Phase]) -> bool:
    """Whether residuals in some phases are clearly above what noise leaves: by two standard errors over tosses.

    Args:
        rows: Of a hypothesis.
        phases: Which.
    """
    above = rows.excess_where(np.isin(rows.phase, phases))
    return bool(above.sum() > 2 * np.sqrt(len(above)) * above.std())


def share_closed_in(before: Rows, after: Rows, phases: Sequence[Phase]) -> float:
    """The share of the gap in some phases that is closed; 1 where there was none.

    Args:
        before: Of the simulator as it is stated.
        after: With what was found.
        phases: Which.
    """
    whole, left = (float(each.excess[np.isin(each.phase, phases)].sum()) for each in (before, after))
    return 1.0 - left / whole if whole > 0 else 1.0


def in_short(rows: Rows) -> str:
    """The size of a gap, and the phase and channel that have most of it, in a few words.

    Args:
        rows: Of a hypothesis.
    """
    squares = rows.whitened**2
    phase = max(PHASES, key=lambda each: float((squares[rows.phase == each] - 1).sum()))
    channel = channels_of(squares.shape[1])[int(squares.sum(0).argmax())]
    return (
        f"the gap over short windows is {np.sqrt(squares.mean()):.1f} standard deviations of noise "
        f"({1e3 * rows.position_rms:.2g} mm, {np.rad2deg(rows.rotation_rms):.2g} deg), "
        f"most in {phase.name.lower()} and {channel}"
    )


def channels_of(count: int) -> tuple[str, ...]:
    """Names of channels.

    Args:
        count: How many.
    """
    return (*CHANNELS, *(f"joint_{i}" for i in range(1, count - len(CHANNELS) + 1)))
