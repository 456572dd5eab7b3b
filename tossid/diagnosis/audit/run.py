"""Audits: cases are made, sealed, diagnosed, unsealed and scored. Does a diagnosis find what is withheld from it?

The steps of a case share files only. The diagnosis gets a dataset that came through TUM files, and nothing else; the
truth lies unreadable elsewhere until the diagnosis has ended, and its hash is published before.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tossid.code_digest import code_digest
from tossid.diagnosis.audit import steps
from tossid.diagnosis.audit.cases import draw_cases, draw_over_order, draw_spoilt
from tossid.diagnosis.audit.result import Audit
from tossid.diagnosis.audit.sealing import seal, unseal
from tossid.diagnosis.audit.spoilt import Reference, find_reference
from tossid.diagnosis.audit.steps import Job
from tossid.diagnosis.audit.strengths import strengths_for, world_with
from tossid.errors import ConfigError, InputError, TossidError
from tossid.objects import ObjectModel, load_object
from tossid.outputs import only_writer, output_folder, write_whole
from tossid.parallel import as_done
from tossid.physics.effects import World
from tossid.plain_json import jsonable
from tossid.settings.changed import changed
from tossid.settings.diagnosis.audit import AuditSettings
from tossid.settings.objects import ObjectSettings
from tossid.store import file_sha256
from tossid.synthesis.engines import ENGINES
from tossid.synthesis.foreign_engines import check_installed
from tossid.types import Progress, silent

RESULT, GAP, REFERENCE = "result.json", "gap.json", "reference.json"
"""Names of files: a case's score and diagnosis, and what real tosses say of the unspoilt simulator."""

Submit = Callable[..., Future[Any]]
"""Gives a call to a worker: from a function and its arguments to the future result."""

Finished = Iterator[tuple[Job, dict[str, Any] | TossidError]]
"""Jobs with their results, or with the error that they ended in."""
Each = Callable[[Callable[[Job], dict[str, Any]], Sequence[Job]], Finished]
"""Runs a function on jobs, in any order and as many at a time as it likes."""


def in_this_process(function: Callable[..., Any], *args: Any) -> Future[Any]:
    """Compute a call at once, in this process.

    Args:
        function: What is called.
        *args: Its arguments.

    Returns:
        The result or the error, as a future.
    """
    future: Future[Any] = Future()
    try:
        future.set_result(function(*args))
    except Exception as error:
        future.set_exception(error)
    return future


def audit(
    object: str | Path | ObjectSettings | ObjectModel = "cube",
    *,
    out: str | Path,
    data: str | Path | None = None,
    settings: AuditSettings = AuditSettings(),
    submit: Submit = in_this_process,
    each: Each = as_done,
    threads: int | None = None,
    progress: Progress | None = None,
    **keys: Any,
) -> Audit:
    """Diagnose tosses whose effect is withheld, case by case; cases that are done already are kept.

    Args:
        object: What is tossed: a known name, the path of an MJCF or URDF file, settings, or a loaded object.
        out: The audit's folder.
        data: A dataset of real tosses: the simulator is spoilt instead, relative to what a first diagnosis finds.
        settings: Which cases, and how they are made and scored.
        submit: Gives the steps of a case to workers.
        each: Runs the cases; what it runs waits for workers.
        threads: Threads of the first diagnosis of real tosses; None: one a core.
        progress: Called with what is under way, and the share that is done.
        **keys: Settings by name, such as `cases=4` or `tosses=12`.

    Returns:
        The audit: a row for each case, and how many were right. `save()` writes its tables and figures.

    Raises:
        ConfigError: A key is no setting, no engine is named, one is not installed, the simulator of an object with
            joints is to be spoilt, or tosses cannot be filmed.
        InputError: All cases failed.
    """
    model, settings, out = load_object(object), changed(settings, keys), Path(out)
    data = None if data is None else Path(data).resolve()
    if not settings.engines:
        raise ConfigError("engines", "is empty; an audit needs at least one.")
    for engine in settings.engines:
        check_installed(engine, "engines")
    if settings.filmed and data is not None:
        raise ConfigError(
            "filmed", "is of cases that are made; tosses of data= are recorded already. Omit one of both."
        )
    if settings.filmed and not model.tags:
        raise ConfigError("filmed", f"'{model.name}' has no tags that a camera could see; give them.")
    if data is not None and model.n_joints:
        raise ConfigError("data", "only simulators of single bodies are spoilt; omit it to make cases of the object.")
    report, code = progress or silent, code_digest(steps.__name__)
    with only_writer(out / "audit"):
        reference = None
        if data is not None:
            report("diagnosing the unspoilt simulator", 0.0)
            reference = _reference(data, model, settings, out, submit=submit, threads=threads, code=code)
        jobs = plan(model, settings, data=data, reference=reference, code=code)
        results = {job.name: result for job in jobs if (result := stored(out, job)) is not None}
        failed: dict[str, str] = {}
        report("", len(results) / len(jobs))
        for job, found in each(partial(run_case, out=out, submit=submit), [j for j in jobs if j.name not in results]):
            if isinstance(found, TossidError):
                failed[job.name] = str(found)
            else:
                results[job.name] = found
            report(job.name, (len(results) + len(failed)) / len(jobs))
    if not results:
        raise InputError(f"all {len(failed)} cases failed; the first: {next(iter(failed.values()))}")
    return Audit.of([results[job.name] for job in jobs if job.name in results], failed, settings.scoring)


def plan(
    model: ObjectModel,
    settings: AuditSettings,
    *,
    data: Path | None = None,
    reference: Reference | None = None,
    code: str = "",
) -> list[Job]:
    """The jobs of an audit.

    Args:
        model: What is tossed.
        settings: Which cases, and how they are made and scored.
        data: The dataset of real tosses, if the simulator is spoilt.
        reference: What these say of the unspoilt simulator.
        code: Digest of the code.

    Returns:
        A job for each case.
    """
    depends = _dependencies(model, settings, data, code)
    only_lcp = only_in_lcp(model, settings.engines)
    if data is None and settings.over_order:
        cases = draw_over_order(
            settings.cases,
            seed=settings.seed,
            engines=settings.engines,
            displacement=settings.displacement,
            tosses=settings.tosses,
        )
    elif data is None:
        cases = draw_cases(
            settings.cases,
            seed=settings.seed,
            engines=settings.engines,
            displacement=settings.displacement,
            effects=[name for name in strengths_for(model) if "lcp" in settings.engines or name not in only_lcp],
            kinds=settings.kinds,
            only_lcp=only_lcp,
        )
    else:
        cases = draw_spoilt(settings.cases, seed=settings.seed)
    return [Job(case, model, settings, _digest({**depends, "case": case.as_json()}), data, reference) for case in cases]


def run_case(job: Job, *, out: Path, submit: Submit = in_this_process) -> dict[str, Any]:
    """Make, seal, diagnose, unseal and score a case; its folder appears whole.

    Args:
        job: The case.
        out: The audit's folder.
        submit: Gives the steps to workers.

    Returns:
        The result, as result.json has it: `truth`, `score`, `closable`, `gap`, `digest`, `name` and `seconds`.
    """
    started = time.perf_counter()
    with output_folder(out / "cases" / job.name, made_by="tossid audit") as folder:
        sealed = seal(submit(steps.make, job, folder).result(), job.name, out, folder)
        gap = jsonable(submit(steps.diagnose, job, folder).result())
        _write_json(folder / GAP, gap)
        truth = unseal(sealed, folder)
        result = submit(steps.score_case, job, folder, truth, gap).result()
        result |= {"digest": job.digest, "name": job.name, "seconds": time.perf_counter() - started}
        _write_json(folder / RESULT, result)
    return dict(jsonable(result))


def stored(out: Path, job: Job) -> dict[str, Any] | None:
    """The result of a case that is done.

    Args:
        out: The audit's folder.
        job: The case.

    Returns:
        The result; None if there is none, or if it depends on anything else.
    """
    found = _read_json(out / "cases" / job.name / RESULT)
    return found if found is not None and found.get("digest") == job.digest else None


# ---------------------------------------------------------------- what is kept


def _reference(
    data: Path,
    model: ObjectModel,
    settings: AuditSettings,
    out: Path,
    *,
    submit: Submit,
    threads: int | None,
    code: str,
) -> Reference:
    """What real tosses say of the unspoilt simulator: kept from an earlier audit, or found now."""
    key = _digest(_dependencies(model, settings, data, code))
    kept = _read_json(out / REFERENCE)
    if kept is not None and kept.get("key") == key:
        return Reference(**kept["reference"])
    found: Reference = submit(find_reference, data, settings, threads or os.cpu_count() or 1).result()
    _write_json(out / REFERENCE, {"key": key, "reference": asdict(found)})
    return found


def _dependencies(model: ObjectModel, settings: AuditSettings, data: Path | None, code: str) -> dict[str, Any]:
    """What every case depends on, beside the case itself."""
    depends = {"object": model, "code": code, "tosses": settings.tosses, "scoring": settings.scoring}
    depends["repeats"] = settings.repeats
    if data is not None:
        return {**depends, "data": file_sha256(data), "seed": settings.seed}
    noise = {"position_noise": settings.position_noise, "rotation_noise": settings.rotation_noise}
    return {**depends, **noise, "filmed": settings.filmed, "making": settings.making}


def only_in_lcp(model: ObjectModel, engines: Sequence[str]) -> list[str]:
    """Names of effects that one of the engines cannot express; lcp can express all.

    Args:
        model: What is tossed.
        engines: The engines.
    """
    plain, u = World(model), np.full(8, 0.5)
    worlds = {name: world_with(plain, {name: one.values(one.high, u)}) for name, one in strengths_for(model).items()}
    return [name for name, world in worlds.items() if any(ENGINES[engine].lacks(world) for engine in engines)]


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(jsonable(value), sort_keys=True).encode()).hexdigest()


def _read_json(path: Path) -> dict[str, Any] | None:
    try:
        found = json.loads(path.read_text())
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None


def _write_json(path: Path, value: Any) -> None:
    write_whole(path, (json.dumps(jsonable(value), indent=1, allow_nan=False) + "\n").encode())
