"""`tossid audit`: gives the cases of `tossid.audit` to workers; tracks and prints what is found."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from pipelines.cli.console import Console
from pipelines.config.schemas import AuditConfig
from pipelines.execution.workers import submitting

FOLDER = Path("outputs/audit")


def run(config: AuditConfig, console: Console) -> dict[str, Any]:
    """Audit; returns the summary, a row a case, and where all of it lies."""
    from pipelines.tracking.run import tracked_run
    from tossid.audit.result import CASE_HEADINGS, MEASURE_HEADINGS
    from tossid.audit.run import audit

    started = time.perf_counter()
    out = config.out or FOLDER / str(config.seed)
    with (
        submitting(config.launcher, config.workers, config.cases) as submit,
        console.shares(f"auditing {config.cases} cases") as progress,
    ):
        found = audit(config.object, out=out, settings=config, submit=submit, progress=progress)
    for name, problem in found.failed.items():
        console.warn(f"case {name}: {problem}")
    with tracked_run(f"audit-{out.name}", config, command="audit") as tracked:
        figures = found.save(out)
        numbers = {name: value.get("share", value.get("value")) for name, value in found.summary.items()}
        tracked.metrics({name: float(x) for name, x in numbers.items() if x is not None})
        for name in ("audit.json", "table.md", *(["figures"] if figures else [])):
            tracked.artifact(out / name)
    console.table(list(CASE_HEADINGS), found.case_table())
    console.table(list(MEASURE_HEADINGS), found.measure_table())
    where = {"figures": [str(path) for path in figures], "out": str(out), "run": tracked.id}
    return {**found.as_json(), **where, "seconds": time.perf_counter() - started}
