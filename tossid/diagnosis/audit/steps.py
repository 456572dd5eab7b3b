"""The steps of a case that workers compute: making its tosses, diagnosing them, and scoring the diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tossid.diagnosis.audit.cases import OF_LIBRARY, Case
from tossid.diagnosis.audit.making import TOSSES, make_case
from tossid.diagnosis.audit.over_order import score_over_order
from tossid.diagnosis.audit.scores import closable_share, score
from tossid.diagnosis.audit.spoilt import Reference, read_case_tosses, real_tosses, spoil
from tossid.diagnosis.explain import explain
from tossid.diagnosis.findings import FOUND
from tossid.diagnosis.problem import Problem, session_starts
from tossid.diagnosis.sessions.explained import explain_over_order
from tossid.objects import ObjectModel
from tossid.physics.effects import World, effects_for
from tossid.settings.diagnosis.audit import AuditSettings
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.store import read_dataset


@dataclass(frozen=True)
class Job:
    """A case, with all that its result depends on.

    Attributes:
        case: The case.
        model: What is tossed.
        settings: How it is made and scored.
        digest: Hash of all this and of the code.
        data: The dataset of real tosses, if the simulator is spoilt.
        reference: What these say of the unspoilt simulator.
    """

    case: Case
    model: ObjectModel
    settings: AuditSettings
    digest: str
    data: Path | None = None
    reference: Reference | None = None

    @property
    def name(self) -> str:
        """The case's number and the first digits of the digest.

        Returns:
            The name.
        """
        return f"{self.case.index:03d}-{self.digest[:8]}"


def make(job: Job, folder: Path) -> dict[str, Any]:
    """Make a case; its tosses are then in the folder.

    Args:
        job: The case.
        folder: Its folder.

    Returns:
        The truth.
    """
    if job.reference is None:
        return make_case(job.case, job.model, job.settings, folder)
    return spoil(job.case, _real(job)[1], job.reference)[1]


def diagnose(job: Job, folder: Path) -> dict[str, Any]:
    """gap.json of the stated simulator on the case's tosses, or of the spoilt simulator on real ones.

    Args:
        job: The case.
        folder: Its folder.

    Returns:
        The content of gap.json.
    """
    seed, settings = job.case.seed % 1000, DiagnoseSettings(repeats=job.settings.repeats)
    if job.reference is not None:
        tosses, world = _real(job)
        spoilt = spoil(job.case, world, job.reference)[0]
        return explain(Problem(tosses, spoilt, seed=seed, settings=settings)).as_json()
    return diagnose_withheld(folder / TOSSES, job.case.without, seed, settings)


def diagnose_withheld(
    data: Path, without: Sequence[str], seed: int, settings: DiagnoseSettings = DiagnoseSettings()
) -> dict[str, Any]:
    """gap.json of the stated simulator on a dataset, which is all that the diagnosis gets.

    Args:
        data: The dataset's file.
        without: Effects that are taken out of the library.
        seed: Seed of the diagnosis.
        settings: Of the diagnosis.

    Returns:
        The content of gap.json.
    """
    return explain_over_order(withheld(data, without, seed, settings)).repeated().diagnosis.as_json()


def withheld(data: Path, without: Sequence[str], seed: int, settings: DiagnoseSettings = DiagnoseSettings()) -> Problem:
    """The problem of a case: a dataset, and the stated simulator of its object.

    Args:
        data: The dataset's file.
        without: Effects that are taken out of the library.
        seed: Seed of the diagnosis.
        settings: Of the diagnosis.
    """
    tosses, world = read_case_tosses(data)
    library = tuple(effect for effect in effects_for(world.object) if effect.name not in without)
    dataset = read_dataset(data)
    names = tuple(toss.name for toss in dataset.tosses)
    starts = session_starts(dataset.order)
    return Problem(tosses, world, library, seed=seed, names=names, sessions=starts, settings=settings)


def score_case(job: Job, folder: Path, truth: dict[str, Any], gap: dict[str, Any]) -> dict[str, Any]:
    """Score the diagnosis of a case.

    Args:
        job: The case.
        folder: Its folder.
        truth: The unsealed truth.
        gap: The content of gap.json.

    Returns:
        `truth`, `score`, `closable` and `gap`, as result.json has them.
    """
    closable = None
    if job.case.kind in OF_LIBRARY:
        tosses, world = read_case_tosses(folder / TOSSES)
        closable = closable_share(tosses, world, truth["effects"], seed=job.case.seed % 1000)
    scored = score(truth, gap, closable=closable, settings=job.settings.scoring)
    if job.case.order is not None:
        scored |= score_over_order(truth, gap, settings=job.settings.scoring)
    return {"truth": truth, "score": scored, "closable": closable, "gap": summary_of(gap)}


def summary_of(gap: dict[str, Any]) -> dict[str, Any]:
    """What a reader of a wrong case needs of its diagnosis.

    Args:
        gap: The content of gap.json.

    Returns:
        The sizes of the gap, and the effects that gained anything.
    """
    findings = [
        {
            "name": f["name"],
            "verdict": f["verdict"],
            "frequency": f["frequency"],
            **f["evidence"],
            "gap_closed": f["gap_closed"]["value"],
            **{key: f[key] for key in ("sessions", "drift", "over_order") if key in f},
            "parameters": {k: v["value"] for k, v in f["parameters"].items()},
        }
        for f in gap["effects"]
        if f["verdict"] in FOUND or f["evidence"]["gain"] > 0
    ]
    return {
        "total": gap["gap"]["total"]["value"],
        "noise_floor": gap["gap"]["noise_floor"],
        "left": gap["gap_left"]["value"],
        "gap_closed": gap["explanation"]["gap_closed"]["value"],
        "unexplained_where": gap["explanation"]["unexplained_where"],
        "findings": findings,
        "seconds": gap["seconds"],
    }


def _real(job: Job) -> tuple[Any, World]:
    assert job.data is not None
    return real_tosses(job.data, job.settings)
