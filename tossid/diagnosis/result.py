"""The result of a diagnosis, all of it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.findings import (
    FOUND,
    Brings,
    Change,
    ChangeLeft,
    Finding,
    Gap,
    Interval,
)
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.learned import LearnedForces
from tossid.diagnosis.localisation.disagreement import SolverDisagreement
from tossid.diagnosis.localisation.noise import MeasuredNoise
from tossid.diagnosis.localisation.place import Place
from tossid.diagnosis.localisation.witnesses import Witness
from tossid.diagnosis.parts import Part, plain
from tossid.diagnosis.patch.make import ASSETS
from tossid.diagnosis.plane import Plane
from tossid.outputs import write_whole
from tossid.plain_json import jsonable
from tossid.types import RecordingOrder

if TYPE_CHECKING:
    from tossid.diagnosis.simulators import Simulator

Array = NDArray[np.float64]
SCHEMA = "tossid.gap/1"
Verdict = Literal["no_gap", "explained", "partly_explained", "unexplained", "within_solver_disagreement", "incomplete"]


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


@dataclass(frozen=True)
class Unseen(Part):
    """What was found, on tosses of the test split, which nothing has seen before.

    Attributes:
        n_tosses: How many.
        gap_closed: Share of the gap above the noise floor that all effects close.
        brings: Whole tosses.
    """

    n_tosses: int
    gap_closed: Interval
    brings: Brings


@dataclass(frozen=True, repr=False)
class Diagnosis:
    """Where a simulator differs from tosses, which effects explain it, and how far they close the gap.

    Attributes:
        verdict: What is said of the whole gap (`verdict`).
        gap: Of the simulator as it is stated.
        left: With what was found, each toss predicted by what was found without it.
        findings: What the tosses say of each effect of the library: what is found first, in the order in which it
            matters, then the others by evidence.
        change: What a person changes, in the order in which it matters.
        brings: What that brings for whole tosses, in the user's own engine wherever it can be run.
        gap_closed: Share of the gap that all effects close, on tosses that took no part.
        unexplained: Phases in which clearly much of the gap is left, with their shares.
        hypothesis: The simulator with all effects.
        n_tosses: How many tosses took part.
        seconds: How long it took.
        folds: Parts of the tosses without which the search was repeated to judge it; 0 if it was not judged.
        draws: How many resampled searches the frequencies are shares of.
        probability_none: Share of them that name nothing; None if none were made.
        passes: How often a user's own simulator was asked for each window, in the mean; None of another.
        alternatives: Hypotheses that may be right instead: with another effect in the place of one.
        place: Where in the state of the motion and on the object the gap is.
        witnesses: What the tosses say of some effects without a simulator.
        disagreement: The gap that another exact solver of the same rigid body shows; None for a user's own contact.
        noise: The noise of the recorded poses over the stated one.
        plane: The plane in which all motion lies, and what it cannot show; None if there is none.
        learned: What the simulator's learned acceleration stands for; None if it has none.
        unseen: What was found, on the test split; None if that was diagnosed itself.
        changes_left: Where something still changes over the order; None where it was not looked at.
        simulator: What was diagnosed.
        tosses_of: The tosses in words: of which dataset, and which of it.
        data: gap.json's "data": the dataset's `path`, `sha256` and `object`.
        next_toss: gap.json's "next_toss": the release that would best separate what is confusable.
        patch: gap.json's "patch": the changed MJCF and keys, and the patched model's rerun in MuJoCo.
        remarks: What a reader should know beside, in sentences.
        order: The dataset's order of recording and its sessions, None where it was not looked at.
        tosses: Names of the tosses in the order of their recording.
        places: Where each ends, x and y as recorded [m], (n, 2).
        interruption: Where it was interrupted; None if it is complete.
    """

    verdict: Verdict
    gap: Gap
    left: Gap
    findings: tuple[Finding, ...]
    change: tuple[Change, ...]
    brings: Brings
    gap_closed: Interval
    unexplained: dict[str, Interval]
    hypothesis: Hypothesis
    n_tosses: int
    seconds: float
    folds: int = 0
    draws: int = 0
    probability_none: float | None = None
    passes: float | None = None
    alternatives: tuple[Hypothesis, ...] = ()
    place: Place = field(default_factory=Place)
    witnesses: tuple[Witness, ...] = ()
    disagreement: SolverDisagreement | None = None
    noise: MeasuredNoise | None = None
    plane: Plane | None = None
    learned: LearnedForces | None = None
    unseen: Unseen | None = None
    changes_left: tuple[ChangeLeft, ...] | None = None
    simulator: Simulator | None = None
    tosses_of: str = ""
    data: dict[str, Any] | None = None
    next_toss: dict[str, Any] | None = None
    patch: dict[str, Any] | None = None
    remarks: tuple[str, ...] = ()
    order: RecordingOrder | None = None
    tosses: tuple[str, ...] = ()
    places: Array = field(default_factory=lambda: np.zeros((0, 2)))
    interruption: Interruption | None = None

    @property
    def contact(self) -> str:
        """The law of contact that the tosses follow most: "coulomb", "routh", "relaxed", or the simulator's "own"."""
        return self.hypothesis.law.name

    @property
    def found(self) -> tuple[Finding, ...]:
        """What the search has found, whatever its verdict."""
        return tuple(f for f in self.findings if f.felt is not None or f.over_order is not None)

    @property
    def named(self) -> tuple[str, ...]:
        """Names of effects that are sure and matter."""
        return tuple(f.name for f in self.found if f.matters and f.verdict in ("identified", "confusable"))

    @property
    def candidates(self) -> tuple[str, ...]:
        """Names of effects that matter and are not sure."""
        return tuple(f.name for f in self.found if f.matters and f.verdict == "candidate")

    @property
    def minor(self) -> tuple[str, ...]:
        """Names of effects that are found, and that whole tosses do not feel."""
        return tuple(f.name for f in self.found if not f.matters and f.verdict in FOUND)

    def finding(self, name: str) -> Finding | None:
        """What is said of an effect; None if it was not looked for.

        Args:
            name: Of the effect.
        """
        return next((f for f in self.findings if f.name == name), None)

    def as_json(self) -> dict[str, Any]:
        """The content of gap.json (schema tossid.gap/1)."""
        gap = {
            "by_phase": _shares("phase", self.gap.by_phase),
            "by_channel": _shares("channel", self.gap.by_channel),
            "odd_tosses": list(self.gap.odd),
            "by_corner": plain(self.place.corners),
            "wrench": plain(self.place.wrench),
        }
        left = {"by_corner": plain(self.place.corners_left), "wrench": plain(self.place.wrench_left)}
        explanation = {
            "verdict": self.verdict,
            "effects": list(self.named),
            "candidates": list(self.candidates),
            "minor": list(self.minor),
            "folds": self.folds,
            "draws": self.draws,
            "probability_none": self.probability_none,
            "gap_closed": plain(self.gap_closed),
            "unexplained_share": max(0.0, 1.0 - self.gap_closed.value),
            "unexplained_where": _shares("phase", self.unexplained),
            "hypothesis": {effect.name: effect.named(x) for effect, x in self.hypothesis.items()},
        }
        beside = {
            "interrupted": self.interruption,
            "next_toss": self.next_toss,
            "patch": self.patch,
            "simulator": self.simulator,
            "data": self.data,
            "passes": self.passes,
            "noise": self.noise,
            "unseen": self.unseen,
            "learned_acceleration": self.learned,
            "solver_disagreement": self.disagreement,
            "plane": self.plane,
            "changes_left": self.changes_left,
        }
        return {
            "schema": SCHEMA,
            "complete": self.interruption is None,
            "n_tosses": self.n_tosses,
            "contact": self.contact,
            "change": plain(self.change),
            "brings": plain(self.brings),
            "gap": {**plain(self.gap), **gap},
            "gap_left": {**plain(self.left), **left},
            "effects": plain(self.findings),
            "explanation": explanation,
            "witnesses": plain(self.witnesses),
            "seconds": self.seconds,
            **{name: plain(value) for name, value in beside.items() if value is not None},
            "remarks": list(self.remarks),
        }

    def save(self, folder: str | Path) -> Path:
        """Write gap.html, gap.json, the figures and, where MJCF can say what was found, patched.xml.

        Args:
            folder: Where to; made if it is not there.

        Returns:
            The folder.

        Raises:
            OutputError: The disk refuses.
        """
        from tossid.diagnosis.report import report_html, report_pngs

        folder, figures, patch = Path(folder), report_pngs(self), self.patch or {}
        gap = json.dumps(jsonable(self.as_json()), indent=2, allow_nan=False) + "\n"
        files = {"gap.html": report_html(self, figures).encode(), "gap.json": gap.encode()}
        files |= {f"figures/{name}.png": png for name, png in figures.items()}
        if patch.get("mjcf"):
            files["patched.xml"] = patch["mjcf"].encode()
            files |= {f"{ASSETS}/{name}": Path(source).read_bytes() for name, source in patch.get("assets", {}).items()}
        for name, content in files.items():
            write_whole(folder / name, content)
        return folder

    def metrics(self) -> dict[str, float]:
        """The main numbers, flat, as a tracker logs them; unknown ones are left out.

        The gap, how much of it is closed, whole tosses before and after, and the parameters of named effects.
        """
        numbers = {
            "gap_total": self.gap.total.value,
            "gap_left": self.left.total.value,
            "noise_floor": self.gap.noise_floor,
            "gap_closed": self.gap_closed.value,
            "n_effects": float(len(self.named)),
            "seconds": self.seconds,
        }
        kinds = {"position_error_pct": self.brings.position_pct(), "rotation_error_deg": self.brings.rotation_deg()}
        for name, (before, after) in kinds.items():
            numbers |= {f"{name}/before": before.value, f"{name}/after": after.value}
        for finding in self.findings:
            if finding.name in self.named:
                numbers |= {f"{finding.name}/{key}": value.value for key, value in finding.parameters.items()}
        return {name: value for name, value in numbers.items() if math.isfinite(value)}

    def __repr__(self) -> str:
        """What to change, what that brings, how sure it is, and what is left."""
        from tossid.diagnosis.report import card_of

        return str(card_of(self))

    def _repr_html_(self) -> str:
        from tossid.diagnosis.report import report_notebook, report_pngs

        return report_notebook(self, report_pngs(self))


def _shares(kind: str, shares: Mapping[str, Interval]) -> list[dict[str, Any]]:
    """Shares of the gap by phase or channel, as gap.json has them."""
    return [{kind: name, **share.as_json("share")} for name, share in shares.items()]
