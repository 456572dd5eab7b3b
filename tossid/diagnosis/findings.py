"""The parts of a diagnosis's result: frozen, plain values and arrays, each with its form in gap.json."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

EffectVerdict = Literal["identified", "candidate", "confusable", "not_supported", "not_identifiable"]

FOUND: tuple[EffectVerdict, ...] = ("identified", "candidate", "confusable")
"""Verdicts of effects that are found, or may be what is found."""


@dataclass(frozen=True)
class Interval:
    """A value with its 95 % interval.

    Attributes:
        value: The estimate.
        low: Lower end.
        high: Upper end.
    """

    value: float
    low: float
    high: float

    def as_json(self) -> dict[str, Any]:
        """{"value", "ci95"}."""
        return {"value": self.value, "ci95": [self.low, self.high]}


@dataclass(frozen=True)
class Share:
    """A part of the gap above the noise floor.

    Attributes:
        name: Of a phase or a channel.
        share: Its share of the whole.
    """

    name: str
    share: Interval


@dataclass(frozen=True)
class Gap:
    """How far predictions are off, in standard deviations of what noise alone would leave.

    Attributes:
        total: Root mean square of whitened residuals.
        noise_floor: What it would be if the simulator were right, from the noise of the recorded poses.
        by_phase: Shares of the excess of deviance over the floor.
        by_channel: Likewise.
        by_length: (frames, root mean square, floor) for windows of several lengths.
        frames: (m, 4) toss, time [s], phase and excess of each row of a window, for figures.
        odd: Names of tosses whose residuals are far larger than the others'.
        after_impacts: The share in frames that follow an impact within the same window, whatever phase they are in:
            what a prediction gets wrong in an impact it carries on to them.
    """

    total: Interval
    noise_floor: float
    by_phase: tuple[Share, ...]
    by_channel: tuple[Share, ...]
    by_length: tuple[tuple[int, float, float], ...]
    frames: Array
    odd: tuple[str, ...]
    after_impacts: Share = Share("after_impacts", Interval(0.0, 0.0, 0.0))


@dataclass(frozen=True)
class Corner:
    """What of the gap above the noise floor arises in frames in which a corner touches, of all frames with contact.

    Attributes:
        place: The corner [m], in the base's frame with all joints at zero.
        share: Its share.
        frames: In how many it touches, alone or with others.
        per_frame: Its share over its share of the frames, 1 for as much as in any contact; None if it never touches.
        link: Number of its link, 0 for the base.
    """

    place: tuple[float, float, float]
    share: Interval
    frames: int
    per_frame: float | None
    link: int = 0

    def as_json(self) -> dict[str, Any]:
        """One of gap.json's "by_corner"."""
        interval = [self.share.low, self.share.high]
        return {
            "corner": list(self.place),
            "link": self.link,
            "share": self.share.value,
            "ci95": interval,
            "frames": self.frames,
            "per_frame": self.per_frame,
        }


@dataclass(frozen=True)
class Relation:
    """The residual wrench of the windows in a phase, and the state that explains one component of it best.

    Attributes:
        phase: "flight" or "contact".
        windows: How many determine the component.
        tosses: Of how many tosses.
        component: Its name (`localisation.relations.COMPONENTS`).
        state: Name of the state (`localisation.relations.STATES`).
        r2: Share of the component's squares that a curve over the state (its mean, if no state is clear) explains on
            tosses that took no part.
        p_value: Probability that signs drawn by toss give as good a best pair.
        clear: Whether the component is clearly there.
        r2_state: As `r2`, beyond the component's mean.
        p_state: As `p_value`, beyond the component's mean.
        state_clear: Whether the component clearly depends on the state.
        means: Of all components over the windows [N], [N m].
        points: (windows, 4) state, component, its standard error, toss.
        curve: (m, 4) state, fitted component, its 95 % band.
    """

    phase: str
    windows: int
    tosses: int
    component: str
    state: str
    r2: Interval
    p_value: float
    clear: bool
    r2_state: Interval
    p_state: float
    state_clear: bool
    means: dict[str, Interval]
    points: Array
    curve: Array

    def as_json(self) -> dict[str, Any]:
        """One of gap.json's "wrench", with five points of the curve."""
        some = self.curve[np.linspace(0, len(self.curve) - 1, 5).round().astype(int)]
        return {
            "phase": self.phase,
            "windows": self.windows,
            "tosses": self.tosses,
            "component": self.component,
            "state": self.state,
            "r2": self.r2.as_json(),
            "p_value": self.p_value,
            "clear": self.clear,
            "r2_state": self.r2_state.as_json(),
            "p_state": self.p_state,
            "state_clear": self.state_clear,
            "curve": [{"state": x, "value": y, "ci95": [low, high]} for x, y, low, high in some.tolist()],
            "means": {name: mean.as_json() for name, mean in self.means.items()},
        }


@dataclass(frozen=True)
class Place:
    """Where in the state of the motion and on the object the gap is.

    Attributes:
        wrench: The stated simulator's residual wrenches by phase.
        corners: Shares of its excess in contact.
        wrench_left: As `wrench`, with the effects in.
        corners_left: As `corners`, with the effects in; of the same whole.
    """

    wrench: tuple[Relation, ...] = ()
    corners: tuple[Corner, ...] = ()
    wrench_left: tuple[Relation, ...] = ()
    corners_left: tuple[Corner, ...] = ()


@dataclass(frozen=True)
class Consequence:
    """How far whole tosses move when one effect is taken out of the last hypothesis, from the same first states.

    Attributes:
        position_pct: Median over tosses of the mean distance over frames [% of the object's width].
        rotation_deg: Median over tosses of the mean angle over frames [deg].
        closed: Share of the gap that the effect closes.
        matters: Whether one of these is beyond its tolerance.
    """

    position_pct: float
    rotation_deg: float
    closed: float
    matters: bool

    def as_json(self) -> dict[str, Any]:
        """An effect's "whole_tosses" in gap.json."""
        return {"position_pct": self.position_pct, "rotation_deg": self.rotation_deg}


@dataclass(frozen=True)
class Stretch:
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

    def as_json(self) -> dict[str, Any]:
        """One of an effect's "sessions" in gap.json."""
        return {
            "first": self.first,
            "last": self.last,
            "n_tosses": self.n_tosses,
            "parameters": {name: value.as_json() for name, value in self.parameters.items()},
        }


@dataclass(frozen=True)
class OverOrder:
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
        about = {"p_value": self.p_value, "undone": self.undone}
        stretches = [stretch.as_json() for stretch in self.stretches]
        if self.form == "steps":
            return {"sessions": stretches, "over_order": about}
        rate = {name: value.as_json() for name, value in self.rate.items()}
        return {"drift": {"per_toss": rate, "ends": stretches}, "over_order": about}


@dataclass(frozen=True)
class Finding:
    """What the tosses say of one effect.

    Attributes:
        name: Of the effect.
        verdict: What is concluded.
        says: The effect in words.
        phases: In which it acts.
        parameters: Values with intervals, if it is named or confusable.
        evidence: Gain of log-likelihood on tosses that took no part in the fit, p-value, number of tosses.
        gap_closed: Share of the gap; of a named effect beyond those before it, else by it alone.
        confusable_with: Other effects of its class.
        detectable: The smallest size of each parameter that these tosses would reveal.
        consequence: What it does to whole tosses, if it is named or confusable.
        frequency: Share of the repeated searches that name it; None if none were made.
        over_order: How it goes over the order of recording; None if it is the same in all tosses.
        correlation: (P, P) of the errors of its parameters, where they have values.
        saturated: Whether more of it changes nothing, so that its interval ends where its range does.
    """

    name: str
    verdict: EffectVerdict
    says: str
    phases: tuple[str, ...]
    parameters: dict[str, Interval]
    evidence: dict[str, float]
    gap_closed: Interval
    confusable_with: tuple[str, ...] = ()
    detectable: dict[str, float] = field(default_factory=dict)
    consequence: Consequence | None = None
    frequency: float | None = None
    over_order: OverOrder | None = None
    correlation: tuple[tuple[float, ...], ...] = ()
    saturated: bool = False

    @property
    def headline(self) -> bool:
        """Whether it is found, or may be what is found, and matters."""
        return self.verdict in FOUND and (self.consequence is None or self.consequence.matters)

    def as_json(self) -> dict[str, Any]:
        """One of gap.json's "effects"."""
        return {
            "name": self.name,
            "verdict": self.verdict,
            "says": self.says,
            "phases": list(self.phases),
            "parameters": {name: value.as_json() for name, value in self.parameters.items()},
            "correlation": [list(row) for row in self.correlation],
            "saturated": self.saturated,
            "evidence": self.evidence,
            "gap_closed": self.gap_closed.as_json(),
            "confusable_with": list(self.confusable_with),
            "frequency": self.frequency,
            "detectable": self.detectable,
            "matters": self.consequence is not None and self.consequence.matters,
            "whole_tosses": None if self.consequence is None else self.consequence.as_json(),
            **({} if self.over_order is None else self.over_order.as_json()),
        }


@dataclass(frozen=True)
class ChangeLeft:
    """A change over the order of recording that no found effect explains.

    Attributes:
        before: Name of the first toss after it.
        p_values: By effect, or "residual" for the size of the gap, the probability of such a change in an order that
            means nothing, corrected for all that was looked at.
    """

    before: str
    p_values: dict[str, float]

    def as_json(self) -> dict[str, Any]:
        """One of gap.json's "changes_left"."""
        return {"before": self.before, "p_values": self.p_values}


@dataclass(frozen=True)
class Step:
    """Rollout errors on tosses that took no part in the fit, with some effects in.

    Attributes:
        effects: Their names.
        position_error_pct: Mean distance, in % of the object's width; each toss at values fitted to the other folds.
        rotation_error_deg: Mean angle, likewise.
        gap_left: Mean square of whitened residuals, likewise.
        unseen_position_error_pct: Of other tosses, at values fitted to all of these; None if there are none.
        unseen_rotation_error_deg: Likewise.
    """

    effects: tuple[str, ...]
    position_error_pct: Interval
    rotation_error_deg: Interval
    gap_left: Interval
    unseen_position_error_pct: Interval | None = None
    unseen_rotation_error_deg: Interval | None = None

    def as_json(self) -> dict[str, Any]:
        """One of gap.json's "steps"."""
        values = {
            "position_error_pct": self.position_error_pct,
            "rotation_error_deg": self.rotation_error_deg,
            "gap_left": self.gap_left,
            "unseen_position_error_pct": self.unseen_position_error_pct,
            "unseen_rotation_error_deg": self.unseen_rotation_error_deg,
        }
        plain = {name: None if value is None else value.as_json() for name, value in values.items()}
        return {"effects": list(self.effects), **plain}
