"""What a diagnosis says. Frozen, plain values and arrays; `as_json` gives CONTRACT.md's gap.json."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.evidence import Hypothesis

Array = NDArray[np.float64]

SCHEMA = "tossid.gap/1"
EffectVerdict = Literal["identified", "confusable", "not_supported", "not_identifiable"]
Verdict = Literal["no_gap", "explained", "partly_explained", "unexplained"]
Contact = Literal["coulomb", "relaxed", "own"]


@dataclass(frozen=True)
class Interval:
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float

    def as_json(self) -> dict[str, Any]:
        """{"value", "ci95"}."""
        return {"value": self.value, "ci95": [self.low, self.high]}


@dataclass(frozen=True)
class Share:
    """Part `name` (a phase, a channel) of the gap above the noise floor; `rms_mm` where it is a length."""

    name: str
    share: Interval


@dataclass(frozen=True)
class Gap:
    """How far predictions miss, in standard deviations of what noise alone would leave.

    total: root mean square of whitened misses over tosses; noise_floor: what it would be were the simulator right
    (computed by simulation). by_phase, by_channel: shares of the excess of squares. by_length: root mean square for
    windows of so many frames, with the floor's. frames: one row a whitened frame (toss, time [s], phase, excess),
    for pictures. odd: names of tosses that miss far more than the others.
    """

    total: Interval
    noise_floor: float
    by_phase: tuple[Share, ...]
    by_channel: tuple[Share, ...]
    by_length: tuple[tuple[int, float, float], ...]
    frames: Array
    odd: tuple[str, ...]


@dataclass(frozen=True)
class Corner:
    """What of the gap above the floor comes in frames in which a corner touches, of all frames in contact.

    place [m], in the base's frame with all joints at zero; link: whose, 0 for the base. frames: in which it touches,
    alone or with others. per_frame: its share over its share of the frames, 1 for as much as in any contact; None for
    a corner that never touches.
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

    component, state: names of `wrench`. r2: share of the component's squares that a curve over the state (its mean, if
    no state is clear) explains on tosses that took no part; p_value: that signs drawn by toss give as good a best pair;
    clear: whether that is a finding. r2_state, p_state, state_clear: the same beyond the component's mean.
    means: of all components over the windows [N], [N m]. points (windows, 4): state, component, its standard error,
    toss. curve (m, 4): state, fitted component, its 95 % band.
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
        """One of gap.json's "wrench"; the curve at its ends and between, forces in N, torques in N m."""
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
    """Where in the state and on the object the gap is: of the stated simulator, and with the named effects in.

    wrench: residual wrenches by phase. corners: shares of the first gap's excess in contact.
    """

    wrench: tuple[Relation, ...] = ()
    corners: tuple[Corner, ...] = ()
    wrench_left: tuple[Relation, ...] = ()
    corners_left: tuple[Corner, ...] = ()


@dataclass(frozen=True)
class Finding:
    """What the tosses say of one effect.

    parameters: values with intervals, of the effects that are named or confusable. evidence: gain of log-likelihood
    on tosses that took no part in the fit, p-value, number of tosses. gap_closed: if found, beyond those before it;
    else by it alone. detectable: the smallest size of each parameter that these tosses would have shown.
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

    def as_json(self) -> dict[str, Any]:
        """One of gap.json's "effects"."""
        return {
            "name": self.name,
            "verdict": self.verdict,
            "says": self.says,
            "phases": list(self.phases),
            "parameters": {name: value.as_json() for name, value in self.parameters.items()},
            "evidence": self.evidence,
            "gap_closed": self.gap_closed.as_json(),
            "confusable_with": list(self.confusable_with),
            "detectable": self.detectable,
        }


@dataclass(frozen=True)
class Step:
    """Rollout errors on tosses that took no part in the fit, with these effects in: each toss at values fitted to the
    other folds, and (unseen) other tosses at values fitted to all of these, if there are any.

    gap_left: mean square of whitened misses.
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


@dataclass(frozen=True)
class Witness:
    """A quantity that tosses show without a simulator (`witnesses`), beside what the stated simulator has for it and
    what the diagnosis found. effect: of which it speaks. tosses: that show it."""

    quantity: str
    effect: str
    stated: float
    found: float
    measured: Interval
    tosses: int

    def as_json(self) -> dict[str, Any]:
        """One of gap.json's "witnesses"."""
        return {
            "quantity": self.quantity,
            "effect": self.effect,
            "stated": self.stated,
            "found": self.found,
            "measured": self.measured.as_json(),
            "tosses": self.tosses,
        }


@dataclass(frozen=True)
class Diagnosis:
    """All of it. named: the effects that explain the gap, in order of what is lost without each.

    gap_closed: by all named together; unexplained: phases (by name) in which clearly something is left, with the
    share of the first gap that is left there. hypothesis: the world with all of them, fitted to all tosses.
    contact: what the tosses follow most of Coulomb's law, its relaxation and a MuJoCo model's own; it is no effect.
    alternatives: the same with a confusable effect swapped in. place: where in the state and on the object.
    witnesses: what tosses say of some effects without a simulator. other_laws: effects that are in the hypothesis for
    a force that grows with so much another power of its state than theirs; unsteady: for one that is not the same in
    all tosses. Such forces have no name.
    """

    verdict: Verdict
    gap: Gap
    left: Gap
    findings: tuple[Finding, ...]
    named: tuple[str, ...]
    gap_closed: Interval
    unexplained: tuple[Share, ...]
    steps: tuple[Step, ...]
    hypothesis: Hypothesis
    n_tosses: int
    seconds: float
    alternatives: tuple[Hypothesis, ...] = ()
    contact: Contact = "coulomb"
    place: Place = field(default_factory=Place)
    witnesses: tuple[Witness, ...] = ()
    other_laws: tuple[tuple[str, Interval], ...] = ()
    unsteady: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """gap.json but for next_toss and patch."""
        gap = {
            "total": {**self.gap.total.as_json(), "unit": "standard deviations of noise"},
            "noise_floor": self.gap.noise_floor,
            "by_phase": [{"phase": s.name, **_share(s)} for s in self.gap.by_phase],
            "by_channel": [{"channel": s.name, **_share(s)} for s in self.gap.by_channel],
            "by_length": [{"frames": n, "rms": rms, "floor": floor} for n, rms, floor in self.gap.by_length],
            "odd_tosses": list(self.gap.odd),
            "by_corner": [corner.as_json() for corner in self.place.corners],
            "wrench": [relation.as_json() for relation in self.place.wrench],
        }
        left = {
            **self.left.total.as_json(),
            "noise_floor": self.left.noise_floor,
            "by_corner": [corner.as_json() for corner in self.place.corners_left],
            "wrench": [relation.as_json() for relation in self.place.wrench_left],
        }
        return {
            "schema": SCHEMA,
            "n_tosses": self.n_tosses,
            "contact": self.contact,
            "gap": gap,
            "gap_left": left,
            "effects": [finding.as_json() for finding in self.findings],
            "explanation": {
                "verdict": self.verdict,
                "effects": list(self.named),
                "gap_closed": self.gap_closed.as_json(),
                "unexplained_share": max(0.0, 1.0 - self.gap_closed.value),
                "unexplained_where": [{"phase": s.name, **_share(s)} for s in self.unexplained],
                "other_laws": [{"like": name, "further_power": each.as_json()} for name, each in self.other_laws],
                "unsteady": list(self.unsteady),
            },
            "steps": [step.as_json() for step in self.steps],
            "witnesses": [witness.as_json() for witness in self.witnesses],
            "seconds": self.seconds,
        }


def _share(share: Share) -> dict[str, Any]:
    return {"share": share.share.value, "ci95": [share.share.low, share.share.high]}
