"""The result of a diagnosis, all of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.findings import ChangeLeft, Finding, Gap, Interval, Place, Share, Step
from tossid.diagnosis.learned import LearnedForces
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.localisation.disagreement import SolverDisagreement
from tossid.diagnosis.localisation.misspecification import Misspecification
from tossid.diagnosis.localisation.noise import MeasuredNoise
from tossid.diagnosis.localisation.refusal import Refuted, RolloutCheck
from tossid.diagnosis.localisation.unseen import Unseen
from tossid.diagnosis.selection.plane import Plane
from tossid.diagnosis.selection.significance import TossesNeeded
from tossid.diagnosis.selection.stability import Stability
from tossid.diagnosis.witness import Witness
from tossid.settings.diagnosis.report import ReportSettings
from tossid.types import RecordingOrder

if TYPE_CHECKING:
    from tossid.diagnosis.simulators import Simulator

Array = NDArray[np.float64]
SCHEMA = "tossid.gap/1"
Verdict = Literal["no_gap", "explained", "partly_explained", "unexplained", "within_solver_disagreement", "incomplete"]
Contact = Literal["coulomb", "routh", "relaxed", "own"]


@dataclass(frozen=True)
class Interruption:
    """Where a diagnosis was interrupted.

    Attributes:
        stage: What was under way.
        suspects: Names of effects that had not been fitted yet, with their gains of log-likelihood by one step.
    """

    stage: str
    suspects: tuple[tuple[str, float], ...] = ()

    def as_json(self) -> dict[str, Any]:
        """gap.json's "interrupted"."""
        return {"during": self.stage, "suspects": [{"name": name, "gain": gain} for name, gain in self.suspects]}


@dataclass(frozen=True, repr=False)
class Diagnosis:
    """Where a simulator differs from tosses, which effects explain it, and how far they close the gap.

    Attributes:
        verdict: What the named effects make of the gap.
        gap: The gap of the simulator as it is stated.
        left: The gap that is left with the named effects in.
        findings: What the tosses say of each effect, ordered by evidence.
        named: Names of the effects that explain the gap and matter, ordered by what is lost without each.
        gap_closed: Share of the gap above the noise floor that all named effects close together.
        unexplained: Phases in which clearly something is left, with its share of the first gap.
        steps: Rollout errors without effects and after each effect that joined.
        hypothesis: The simulator's world with all effects, fitted to all tosses.
        n_tosses: How many tosses were diagnosed.
        seconds: How long it took [s].
        alternatives: Hypotheses that may be right instead: with other causes that do the same in flight, and with one
            effect replaced by another of its confusable class.
        exchanged: Names of effects of the hypothesis, and of those other causes; both empty if there are none.
        contact: The contact law that the tosses follow most: Coulomb's, its convex relaxation, or the MuJoCo model's
            own. It is no effect.
        place: Where in the state of the motion and on the object the gap is.
        witnesses: What the tosses say of some effects without a simulator.
        other_laws: Effects that stand in for a force of another law, each with the further power of its state by which
            that force grows. Such a force has no name.
        unsteady: Effects that stand in for a force that is not the same in all tosses. Nor has such a force a name.
        simulator: What was diagnosed.
        tosses_of: The tosses in words: of which dataset, and which of it.
        data: gap.json's "data": the dataset's `path`, `sha256` and `object`.
        next_toss: gap.json's "next_toss": the release that would best separate what is confusable.
        patch: gap.json's "patch": the changed MJCF and keys, and the patched simulator's rerun.
        remarks: What a reader should know beside, in sentences.
        order: The dataset's order of recording and its sessions, None where it was not looked at.
        needed: How many tosses a name needs; None where it was not computed.
        noise: The noise of the recorded poses over the stated one; None where it was not measured.
        misspecification: What the diagnosis itself leaves of the found world's own motions; no verdict rests on it.
        unseen: What was found, on tosses that took no part; None if there were none.
        minor: Names of effects that were found too, and are too small to matter.
        rollouts: What the effects do to whole tosses that took no part in the fits; None without effects.
        refuted: Effects without which it was searched once more, as whole tosses refute them; None if there are none.
        candidates: Names of effects that are significant and matter, but that repeated searches name too rarely, that
            leave most of the gap, or that make predictions of whole tosses worse.
        stability: What repeated searches name.
        plane: The plane in which all motion lies, and what it cannot show; None if there is none.
        implausible: Effects of the hypothesis that have no name, with why: "no_change" or "at_bound".
        disagreement: The gap that another exact solver of the same rigid body shows; None for a user's own contact.
        learned: What the simulator's learned acceleration stands for; None if it has none.
        report: What the figures of the report draw.
        tosses: Names of the tosses in the order in which they were diagnosed, that of their recording.
        places: Where each ends, x and y as recorded [m], (n, 2).
        changes_left: Where something still changes over the order with everything in; None where it was not looked at.
        interruption: Where it was interrupted; None if it is complete.
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
    exchanged: tuple[tuple[str, ...], tuple[str, ...]] = ((), ())
    contact: Contact = "coulomb"
    place: Place = field(default_factory=Place)
    witnesses: tuple[Witness, ...] = ()
    other_laws: tuple[tuple[str, Interval], ...] = ()
    unsteady: tuple[str, ...] = ()
    simulator: Simulator | None = None
    tosses_of: str = ""
    data: dict[str, Any] | None = None
    next_toss: dict[str, Any] | None = None
    patch: dict[str, Any] | None = None
    remarks: tuple[str, ...] = ()
    order: RecordingOrder | None = None
    needed: TossesNeeded | None = None
    minor: tuple[str, ...] = ()
    candidates: tuple[str, ...] = ()
    stability: Stability = Stability()
    plane: Plane | None = None
    implausible: tuple[tuple[str, str], ...] = ()
    disagreement: SolverDisagreement | None = None
    unseen: Unseen | None = None
    rollouts: RolloutCheck | None = None
    refuted: Refuted | None = None
    noise: MeasuredNoise | None = None
    misspecification: Misspecification | None = None
    learned: LearnedForces | None = None
    report: ReportSettings = ReportSettings()
    tosses: tuple[str, ...] = ()
    places: Array = field(default_factory=lambda: np.zeros((0, 2)))
    changes_left: tuple[ChangeLeft, ...] | None = None
    interruption: Interruption | None = None

    @property
    def found(self) -> tuple[str, ...]:
        """Names of effects that are significant and matter, those that are sure first."""
        return (*self.named, *self.candidates)

    def as_json(self) -> dict[str, Any]:
        """The content of gap.json (schema tossid.gap/1)."""
        gap = {
            "total": {**self.gap.total.as_json(), "unit": "standard deviations of noise"},
            "noise_floor": self.gap.noise_floor,
            "by_phase": [{"phase": s.name, **_share(s)} for s in self.gap.by_phase],
            "by_channel": [{"channel": s.name, **_share(s)} for s in self.gap.by_channel],
            "by_length": [{"frames": n, "rms": rms, "floor": floor} for n, rms, floor in self.gap.by_length],
            "after_impacts": _share(self.gap.after_impacts),
            "odd_tosses": list(self.gap.odd),
            "by_corner": [corner.as_json() for corner in self.place.corners],
            "wrench": [relation.as_json() for relation in self.place.wrench],
        }
        left = {
            **self.left.total.as_json(),
            "noise_floor": self.left.noise_floor,
            "after_impacts": _share(self.left.after_impacts),
            "by_corner": [corner.as_json() for corner in self.place.corners_left],
            "wrench": [relation.as_json() for relation in self.place.wrench_left],
        }
        whole = {
            "schema": SCHEMA,
            "complete": self.interruption is None,
            "n_tosses": self.n_tosses,
            "contact": self.contact,
            "gap": gap,
            "gap_left": left,
            "effects": [finding.as_json() for finding in self.findings],
            "explanation": {
                "verdict": self.verdict,
                "effects": list(self.named),
                "candidates": list(self.candidates),
                "repeats": len(self.stability.repeats),
                "repeated": [each.as_json() for each in self.stability.repeats],
                "probability_none": self.stability.probability_none,
                "gap_closed": self.gap_closed.as_json(),
                "unexplained_share": max(0.0, 1.0 - self.gap_closed.value),
                "unexplained_where": [{"phase": s.name, **_share(s)} for s in self.unexplained],
                "other_laws": [{"like": name, "further_power": each.as_json()} for name, each in self.other_laws],
                "unsteady": list(self.unsteady),
                "minor": list(self.minor),
                "same_in_flight": [list(names) for names in self.exchanged if names],
                "refused": [] if self.rollouts is None else list(self.rollouts.refused),
                "refuted": None if self.refuted is None else self.refuted.as_json(),
                "no_name": [{"like": name, "why": why} for name, why in self.implausible],
                "hypothesis": {effect.name: effect.named(x) for effect, x in self.hypothesis.items()},
            },
            "steps": [step.as_json() for step in self.steps],
            "witnesses": [witness.as_json() for witness in self.witnesses],
            "seconds": self.seconds,
        }
        beside = {
            "interrupted": None if self.interruption is None else self.interruption.as_json(),
            "next_toss": self.next_toss,
            "patch": self.patch,
            "simulator": None if self.simulator is None else self.simulator.as_json(),
            "data": self.data,
            "noise": None if self.noise is None else self.noise.as_json(),
            "misspecification": None if self.misspecification is None else self.misspecification.as_json(),
            "unseen": None if self.unseen is None else self.unseen.as_json(),
            "rollouts": None if self.rollouts is None else self.rollouts.as_json(),
            "learned_acceleration": None if self.learned is None else self.learned.as_json(),
            "solver_disagreement": None if self.disagreement is None else self.disagreement.as_json(),
            "plane": None if self.plane is None else self.plane.as_json(),
            "tosses_needed": None if self.needed is None else self.needed.as_json(),
            "changes_left": None if self.changes_left is None else [each.as_json() for each in self.changes_left],
        }
        whole |= {name: value for name, value in beside.items() if value is not None}
        return {**whole, "remarks": list(self.remarks)}

    def save(self, folder: str | Path) -> Path:
        """Write gap.html, gap.json, the figures and, where MJCF can say what was found, patched.xml.

        Args:
            folder: Where to; made if it is not there.

        Returns:
            The folder.

        Raises:
            OutputError: The disk refuses.
        """
        from tossid.diagnosis.presentation import save

        return save(self, Path(folder))

    def metrics(self) -> dict[str, float]:
        """The main numbers, flat, as a tracker logs them; unknown ones are left out.

        The gap, how much of it is closed, the first and last rollouts' errors, and the parameters of named effects.
        """
        numbers = {
            "gap_total": self.gap.total.value,
            "gap_left": self.left.total.value,
            "noise_floor": self.gap.noise_floor,
            "gap_closed": self.gap_closed.value,
            "n_effects": float(len(self.named)),
            "seconds": self.seconds,
        }
        for when, step in (("before", self.steps[:1]), ("after", self.steps[-1:])):
            for each in step:
                numbers[f"position_error_pct/{when}"] = each.position_error_pct.value
                numbers[f"rotation_error_deg/{when}"] = each.rotation_error_deg.value
        for finding in self.findings:
            if finding.name in self.named:
                numbers |= {f"{finding.name}/{key}": value.value for key, value in finding.parameters.items()}
        return {name: value for name, value in numbers.items() if math.isfinite(value)}

    def __repr__(self) -> str:
        """The verdict, the effects with intervals, and the share that they close."""
        from tossid.diagnosis.presentation import summary

        return summary(self)

    def _repr_html_(self) -> str:
        from tossid.diagnosis.presentation import notebook_html

        return notebook_html(self)


def _share(share: Share) -> dict[str, Any]:
    return {"share": share.share.value, "ci95": [share.share.low, share.share.high]}
