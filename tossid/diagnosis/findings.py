"""The parts of a diagnosis's result: frozen, plain values and arrays, each with its form in gap.json."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.parts import Part, plain
from tossid.physics.effects import Effect, World
from tossid.types import Phase

Array = NDArray[np.float64]

EffectVerdict = Literal["identified", "candidate", "confusable", "not_supported", "not_identifiable"]

FOUND: tuple[EffectVerdict, ...] = ("identified", "candidate", "confusable")
"""Verdicts of effects that are found, or may be what is found."""
FELT_PCT, FELT_DEG = 0.5, 0.5
"""Change of whole tosses from which a person would notice it [% of the width], [deg]: means over frames."""
FEWEST_TOSSES = 12
"""Tosses from which on a test over the whole library can name an effect of contact: no p-value is below 2^(1 - n)."""
RESAMPLES = 500
"""Of tosses, for intervals of means and shares."""
LEAST_BELOW = 1e-9
"""Denominator of a ratio at least; of nothing, no part is a share."""


@dataclass(frozen=True)
class Interval(Part):
    """A value with its 95 % interval.

    Attributes:
        value: The estimate.
        low: Lower end.
        high: Upper end.
    """

    value: float
    low: float
    high: float

    @staticmethod
    def of(value: float, drawn: Array) -> Interval:
        """A value with its percentile interval.

        Args:
            value: The estimate.
            drawn: (r,) what resampled tosses give.
        """
        low, high = np.percentile(drawn, [2.5, 97.5])
        return Interval(float(value), float(low), float(high))

    def scaled(self, by: float) -> Interval:
        """All three times a factor.

        Args:
            by: The factor, not negative.
        """
        return Interval(by * self.value, by * self.low, by * self.high)

    def as_json(self, name: str = "value") -> dict[str, Any]:
        """{"value", "ci95"}.

        Args:
            name: Under which the value stands: of a part of the gap, "share".
        """
        return {name: self.value, "ci95": [self.low, self.high]}


NOTHING = Interval(0.0, 0.0, 0.0)
"""A share of nothing."""


@dataclass(frozen=True)
class Gap(Part):
    """How far predictions are off, in standard deviations of what noise alone would leave.

    Attributes:
        total: Root mean square of whitened residuals.
        noise_floor: What it would be if the simulator were right, from the noise of the recorded poses.
        position_mm: Root mean square distance of predictions over short windows [mm].
        rotation_deg: Root mean square angle, likewise [deg].
        by_phase: Shares of the excess of deviance over the floor, by the phase's name.
        by_channel: Likewise by channel.
        frames: (m, 4) toss, time [s], phase and excess of each row of a window, for figures.
        odd: Names of tosses whose residuals are far larger than the others'.
        after_impacts: The share in frames that follow an impact within the same window, whatever phase they are in:
            what a prediction gets wrong in an impact it carries on to them.
    """

    total: Interval
    noise_floor: float
    position_mm: float
    rotation_deg: float
    by_phase: dict[str, Interval]
    by_channel: dict[str, Interval]
    frames: Array
    odd: tuple[str, ...]
    after_impacts: Interval = NOTHING

    def as_json(self) -> dict[str, Any]:
        """The sizes of gap.json's "gap" and "gap_left"."""
        return {
            "total": {**self.total.as_json(), "unit": "standard deviations of noise"},
            "noise_floor": self.noise_floor,
            "position_mm": self.position_mm,
            "rotation_deg": self.rotation_deg,
            "after_impacts": self.after_impacts.as_json("share"),
        }


@dataclass(frozen=True)
class Felt(Part):
    """Differences of whole tosses, means over frames.

    Attributes:
        position_pct: Of the object's width.
        rotation_deg: Of its attitude.
    """

    position_pct: float
    rotation_deg: float

    def is_over(self, limit: Felt | None = None) -> bool:
        """Whether a person would notice it: it exceeds half a percent or half a degree, and what noise alone makes.

        Args:
            limit: What noise of the first states makes of the same tosses; nothing if None.
        """
        noise = limit or Felt(0.0, 0.0)
        position, rotation = max(FELT_PCT, noise.position_pct), max(FELT_DEG, noise.rotation_deg)
        return self.position_pct > position or self.rotation_deg > rotation


@dataclass(frozen=True)
class Stretch(Part):
    """Tosses that follow each other, and what an effect is in them.

    Attributes:
        first: Name of the first toss.
        last: Name of the last one.
        n_tosses: How many.
        parameters: Of the effect.
    """

    first: str
    last: str
    n_tosses: int
    parameters: dict[str, Interval]


@dataclass(frozen=True)
class OverOrder(Part):
    """How an effect goes over the order of recording.

    Attributes:
        form: It takes steps between sessions, or drifts.
        stretches: The sessions; of a drift, the first toss and the last.
        rate: Of a drift, the change of each parameter from toss to toss.
        p_value: Probability of such a change in an order that means nothing, corrected for all that was looked at.
        undone: Whether the tosses were corrected for it before other effects were sought.
    """

    form: Literal["steps", "drift"]
    stretches: tuple[Stretch, ...]
    rate: dict[str, Interval]
    p_value: float
    undone: bool

    def as_json(self) -> dict[str, Any]:
        """An effect's "sessions" or "drift" in gap.json, and "over_order"."""
        stretches, about = plain(self.stretches), {"p_value": self.p_value, "undone": self.undone}
        if self.form == "steps":
            return {"sessions": stretches, "over_order": about}
        return {"drift": {"per_toss": plain(self.rate), "ends": stretches}, "over_order": about}


@dataclass(frozen=True)
class Finding(Part):
    """What the tosses say of one effect.

    Attributes:
        name: Of the effect.
        verdict: What is concluded (`verdict`).
        says: The effect in words.
        phases: In which it acts.
        parameters: Values with intervals, if it is found or may be the cause in place of what is.
        stated: Values of the same parameters in the simulator as it is stated.
        evidence: Gain of log-likelihood by values that other tosses determine, p-value, number of tosses.
        gap_closed: Share of the gap that is lost without it, on tosses that took no part.
        confusable_with: Other effects that may be the cause in its place.
        detectable: The smallest size of each parameter that these tosses would reveal.
        felt: How whole tosses change without it, if it is found.
        frequency: Share of resampled searches that name it; None if none were made.
        over_order: How it goes over the order of recording; None if it is the same in all tosses.
        correlation: (P, P) of the errors of its parameters, where they have values.
    """

    name: str
    verdict: EffectVerdict
    says: str
    phases: tuple[str, ...]
    parameters: dict[str, Interval]
    stated: dict[str, float]
    evidence: dict[str, float]
    gap_closed: Interval = NOTHING
    confusable_with: tuple[str, ...] = ()
    detectable: dict[str, float] = field(default_factory=dict)
    felt: Felt | None = None
    frequency: float | None = None
    over_order: OverOrder | None = None
    correlation: tuple[tuple[float, ...], ...] = ()

    @staticmethod
    def of(effect: Effect, verdict: EffectVerdict, stated: World, evidence: dict[str, float], **more: Any) -> Finding:
        """What the tosses say of an effect of the library.

        Args:
            effect: The effect.
            verdict: What is concluded.
            stated: The simulator as it is stated.
            evidence: Of the effect.
            **more: Other fields; without `parameters`, it has no values.
        """
        phases = tuple(Phase(phase).name.lower() for phase in effect.phases)
        values = effect.named(effect.nominal(stated))
        more = {"parameters": {}, **more}
        return Finding(effect.name, verdict, effect.says, phases, stated=values, evidence=evidence, **more)

    @property
    def matters(self) -> bool:
        """Whether it is found, and whole tosses change by more than a person would notice."""
        return self.felt is not None and self.felt.is_over()

    def as_json(self) -> dict[str, Any]:
        """One of gap.json's "effects"."""
        whole = super().as_json()
        over_order, felt = whole.pop("over_order") or {}, whole.pop("felt")
        return {**whole, "matters": self.matters, "whole_tosses": felt, **over_order}


@dataclass(frozen=True)
class Change(Part):
    """What a person changes in the simulator, or in the recording.

    Attributes:
        name: Of the effect.
        parameter: Its parameter.
        stated: The value that the simulator has.
        value: The value that the tosses show.
    """

    name: str
    parameter: str
    stated: float
    value: Interval

    def as_json(self) -> dict[str, Any]:
        """One of gap.json's "change"."""
        to = {"from": self.stated, "to": self.value.value, "ci95": [self.value.low, self.value.high]}
        return {"name": self.name, "parameter": self.parameter, **to}


@dataclass(frozen=True)
class WholeToss:
    """A toss as it was recorded, and as it is predicted before and after the changes.

    Attributes:
        name: Of the toss.
        t: Times of its frames (n,) [s].
        measured: Recorded poses (n, nq).
        before: Predicted poses (n, nq).
        after: The same with the changes.
    """

    name: str
    t: Array
    measured: Array
    before: Array
    after: Array


@dataclass(frozen=True)
class Brings(Part):
    """Errors of whole tosses before and after the changes, each predicted by what was found without it.

    Attributes:
        engine: In which they are predicted: the user's own simulator wherever it can be run.
        before: (n, 2) mean position error [% of the width] and rotation error [deg]; NaN where a rollout diverged.
        after: (n, 2) the same with the changes.
        width: Of the object [m].
        unseen: Whether the tosses took no part; else values were fitted to them.
        worst: The toss whose position is farthest off before the changes; None where every rollout diverged.
    """

    engine: Literal["mujoco", "python", "tossid"]
    before: Array
    after: Array
    width: float
    unseen: bool = True
    worst: WholeToss | None = None

    @property
    def n(self) -> int:
        """How many tosses are predicted, before and after."""
        return int(self._both.sum())

    @property
    def _both(self) -> NDArray[np.bool_]:
        return np.asarray(np.isfinite(self.before).all(1) & np.isfinite(self.after).all(1))

    def position_pct(self) -> tuple[Interval, Interval]:
        """Position errors before and after [% of the width]: means over tosses, with intervals over tosses."""
        return mean_over_tosses(self.before[self._both, 0]), mean_over_tosses(self.after[self._both, 0])

    def position_mm(self) -> tuple[Interval, Interval]:
        """The same [mm]."""
        before, after = self.position_pct()
        return before.scaled(10 * self.width), after.scaled(10 * self.width)

    def rotation_deg(self) -> tuple[Interval, Interval]:
        """Rotation errors before and after [deg], likewise."""
        return mean_over_tosses(self.before[self._both, 1]), mean_over_tosses(self.after[self._both, 1])

    @property
    def left(self) -> Felt:
        """What is left: medians over tosses, since contact turns any difference into a large one in a few tosses."""
        if not self.n:
            return Felt(np.inf, np.inf)
        return Felt(*(float(x) for x in np.median(self.after[self._both], axis=0)))

    def is_felt(self, noise: Felt) -> bool:
        """Whether what is left is noticed in clearly more than half of the tosses: by one standard error of a count.

        Args:
            noise: What noise alone makes of such tosses.
        """
        limits = np.array([max(FELT_PCT, noise.position_pct), max(FELT_DEG, noise.rotation_deg)])
        over = ~(self.after <= limits)  # (a rollout that diverged is noticed)
        n = len(over)
        return bool((over.sum(0) > 0.5 * (n + np.sqrt(n))).any())

    def as_json(self) -> dict[str, Any]:
        """gap.json's "brings"."""
        kinds = {
            "position_error_pct": self.position_pct(),
            "rotation_error_deg": self.rotation_deg(),
            "position_error_mm": self.position_mm(),
        }
        out: dict[str, Any] = {"in": self.engine, "n_tosses": self.n, "took_no_part": self.unseen}
        for name, (before, after) in kinds.items():
            intervals = {"before": [before.low, before.high], "after": [after.low, after.high]}
            out[name] = {"before": before.value, "after": after.value, "ci95": intervals}
        return out


def mean_over_tosses(values: Array) -> Interval:
    """The mean of values (n,), with its percentile interval by resampled tosses; NaN of none."""
    return ratio_over_tosses(values, np.ones(len(values)))


def ratio_over_tosses(above: Array, below: Array) -> Interval:
    """sum(above) / sum(below) with its percentile interval by resampled tosses; NaN of none.

    Args:
        above: (n,), one a toss.
        below: (n,), likewise.
    """
    n = len(above)
    if not n:
        return Interval(np.nan, np.nan, np.nan)

    def ratio(top: Array, bottom: Array) -> Array:
        return np.asarray(top / np.where(np.abs(bottom) > LEAST_BELOW, bottom, LEAST_BELOW))

    drawn = np.random.default_rng(0).integers(0, n, (RESAMPLES, n))
    return Interval.of(float(ratio(above.sum(), below.sum())), ratio(above[drawn].sum(1), below[drawn].sum(1)))


@dataclass(frozen=True)
class ChangeLeft(Part):
    """A change over the order of recording that no found effect explains.

    Attributes:
        before: Name of the first toss after it.
        p_value: Probability of a change as clear in an order that means nothing.
    """

    before: str
    p_value: float
