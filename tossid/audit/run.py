"""Audits: does a diagnosis find what is withheld from it, and nothing else?"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tossid.audit.cases import draw_cases
from tossid.audit.result import Audit
from tossid.audit.sealed_case import Job, read_case, run_case
from tossid.audit.strengths import strengths_for, world_with
from tossid.code_digest import code_digest
from tossid.errors import ConfigError, InputError, TossidError
from tossid.objects import ObjectModel, load_object
from tossid.outputs import only_writer
from tossid.parallel import as_done
from tossid.physics.effects import World
from tossid.plain_json import digest_of
from tossid.settings.audit import AuditSettings
from tossid.settings.changed import changed
from tossid.settings.objects import ObjectSettings
from tossid.synthesis.engines import ENGINES
from tossid.synthesis.foreign_engines import check_installed
from tossid.types import Progress, silent


def audit(
    object: str | Path | ObjectSettings | ObjectModel = "cube",
    *,
    out: str | Path,
    settings: AuditSettings = AuditSettings(),
    submit: Callable[..., Future[Any]] | None = None,
    progress: Progress | None = None,
    **keys: Any,
) -> Audit:
    """Diagnose tosses whose effect is withheld, case by case; cases that are done already are kept.

    Args:
        object: What is tossed: a known name, the path of an MJCF or URDF file, settings, or a loaded object.
        out: The audit's folder.
        settings: Which cases, and how they are made and diagnosed.
        submit: Gives a case to a worker, as of an executor; None to compute them one after another, in this process.
        progress: Called with what is under way, and the share that is done.
        **keys: Settings by name, such as `cases=4` or `tosses=12`.

    Returns:
        The audit: a row for each case, and how many were right. `save()` writes its tables and figures.

    Raises:
        ConfigError: A key is no setting, no engine is named, one is not installed, or tosses cannot be filmed.
        InputError: All cases failed.
    """
    model, settings, out = load_object(object), changed(settings, keys), Path(out)
    if not settings.engines:
        raise ConfigError("engines", "is empty; an audit needs at least one.")
    for engine in settings.engines:
        check_installed(engine, "engines")
    if settings.filmed and not model.tags:
        raise ConfigError("filmed", f"'{model.name}' has no tags that a camera could see; give them.")
    report, failed = progress or silent, dict[str, str]()
    with only_writer(out / "audit"):
        jobs = plan(model, settings, code=code_digest())
        waiting = [job for job in jobs if read_case(out, job) is None]
        done = len(jobs) - len(waiting)
        report("", done / len(jobs))
        for job, outcome in as_done(partial(run_case, out=out), waiting, submit):
            if isinstance(outcome, TossidError):
                failed[job.name] = str(outcome)
            done += 1
            report(job.name, done / len(jobs))
        found = {job.name: case for job in jobs if (case := read_case(out, job)) is not None}
    if not found:
        raise InputError(f"all {len(failed)} cases failed; the first: {next(iter(failed.values()))}")
    return Audit.of(found, failed)


def plan(model: ObjectModel, settings: AuditSettings, *, code: str = "") -> list[Job]:
    """The jobs of an audit, one for each case.

    Args:
        model: What is tossed.
        settings: Which cases, and how they are made and diagnosed.
        code: Digest of the code.
    """
    every = ("tosses", "repeats", "position_noise", "rotation_noise", "filmed")
    depends = {"object": model, "code": code, **{name: getattr(settings, name) for name in every}}
    only_lcp = only_in_lcp(model, settings)
    effects = [name for name in strengths_for(model) if "lcp" in settings.engines or name not in only_lcp]
    cases = draw_cases(settings, effects=effects, only_lcp=only_lcp)
    return [Job(case, model, settings, digest_of({**depends, "case": case.as_json()})) for case in cases]


def only_in_lcp(model: ObjectModel, settings: AuditSettings) -> list[str]:
    """Names of effects that one of the engines cannot express; lcp can express all.

    Args:
        model: The object.
        settings: The engines.
    """
    plain, u = World(model), np.full(8, 0.5)
    worlds = {name: world_with(plain, {name: one.values(one.high, u)}) for name, one in strengths_for(model).items()}
    return [name for name, world in worlds.items() if any(ENGINES[engine].lacks(world) for engine in settings.engines)]
