"""A case from its making to its diagnosis: made, sealed, diagnosed, unsealed.

The diagnosis gets a dataset that came through files of poses or images, and nothing else. The truth lies unreadable
elsewhere until the diagnosis has ended, and its hash is published before.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tossid.audit.cases import Case
from tossid.audit.making import TOSSES, make_case
from tossid.audit.sealing import TRUTH, seal, unseal
from tossid.diagnosis.diagnose import diagnose
from tossid.objects import ObjectModel
from tossid.outputs import output_folder, write_whole
from tossid.physics.effects import effects_for
from tossid.plain_json import jsonable
from tossid.settings.audit import AuditSettings
from tossid.store import read_dataset

GAP, RESULT = "gap.json", "result.json"
"""Names of files: a case's diagnosis, and how long it took."""


@dataclass(frozen=True)
class Job:
    """A case, with all that its diagnosis depends on.

    Attributes:
        case: The case.
        model: What is tossed.
        settings: How it is made and diagnosed.
        digest: Hash of all this and of the code.
    """

    case: Case
    model: ObjectModel
    settings: AuditSettings
    digest: str

    @property
    def name(self) -> str:
        """The case's number and the first digits of the digest."""
        return f"{self.case.index:03d}-{self.digest[:8]}"


def run_case(job: Job, out: Path) -> None:
    """Make, seal, diagnose and unseal a case; its folder appears whole.

    Args:
        job: The case.
        out: The audit's folder.
    """
    started = time.perf_counter()
    with output_folder(out / "cases" / job.name, made_by="tossid audit") as folder:
        sealed = seal(make_case(job.case, job.model, job.settings, folder), job.name, out, folder)
        withheld = [effect.name for effect in effects_for(job.model) if effect.name in job.case.without]
        gap = diagnose_withheld(folder / TOSSES, withheld, job.case.seed % 1000, job.settings.repeats)
        _write_json(folder / GAP, gap)
        unseal(sealed, folder)
        _write_json(folder / RESULT, {"digest": job.digest, "seconds": time.perf_counter() - started})


def diagnose_withheld(data: Path, without: Sequence[str], seed: int, repeats: int) -> dict[str, Any]:
    """gap.json of the stated simulator on a dataset, which is all that it gets.

    Args:
        data: The dataset's file.
        without: Effects that are taken out of the library.
        seed: Seed of the diagnosis.
        repeats: As of `diagnose`.
    """
    # (cases are diagnosed at the same time, each by one thread)
    found = diagnose(read_dataset(data), split=None, without=tuple(without), seed=seed, repeats=repeats, threads=1)
    return found.as_json()


def read_case(out: Path, job: Job) -> dict[str, Any] | None:
    """What is known of a case that is done: its `truth`, `gap` and `seconds`; None if it is not done.

    Args:
        out: The audit's folder.
        job: The case.
    """
    folder = out / "cases" / job.name
    try:
        truth, gap, result = (json.loads((folder / name).read_text()) for name in (TRUTH, GAP, RESULT))
    except (OSError, ValueError):
        return None
    return {"truth": truth, "gap": gap, "seconds": result["seconds"]} if result["digest"] == job.digest else None


def _write_json(path: Path, value: Any) -> None:
    write_whole(path, (json.dumps(jsonable(value), indent=1, allow_nan=False) + "\n").encode())
