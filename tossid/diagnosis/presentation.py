"""A diagnosis as it is shown and saved: a few lines, a notebook's HTML, and the report's files."""

from __future__ import annotations

import json
from pathlib import Path

from tossid.diagnosis.report import report_html, report_notebook, report_pngs
from tossid.diagnosis.report.text import headline, verdict_of
from tossid.diagnosis.report.units import closed_share, in_units, parameter
from tossid.diagnosis.result import Diagnosis
from tossid.outputs import write_whole
from tossid.plain_json import jsonable

HEADINGS = ("effect", "estimate (95 % interval)", "closes of the gap", "verdict")


def effect_rows(diagnosis: Diagnosis) -> list[list[str]]:
    """A row for each effect that was found, under `HEADINGS`."""
    return [
        [
            finding.name,
            ", ".join(f"{parameter(key)} {in_units(key, value)}" for key, value in finding.parameters.items()),
            closed_share(finding.gap_closed),
            verdict_of(finding),
        ]
        for finding in diagnosis.findings
        if finding.headline
    ]


def summary(diagnosis: Diagnosis) -> str:
    """The verdict, the effects with their intervals, and the share that they close, in a few lines."""
    rows = ["  " + "; ".join(text for text in row if text) for row in effect_rows(diagnosis)]
    whole = (
        [f"  all named together close {closed_share(diagnosis.gap_closed)}"]
        if diagnosis.named or diagnosis.candidates
        else []
    )
    return "\n".join([headline(diagnosis), *rows, *whole])


def notebook_html(diagnosis: Diagnosis) -> str:
    """The verdict in sentences, the effects in a table, the main figures, and the other ones folded away."""
    return report_notebook(diagnosis, report_pngs(diagnosis, settings=diagnosis.report))


def save(diagnosis: Diagnosis, folder: Path) -> Path:
    """Write gap.html, gap.json, figures/ and, where the patch has one, patched.xml.

    Args:
        diagnosis: What `diagnose` returned.
        folder: Where to; made if it is not there.

    Returns:
        The folder.

    Raises:
        OutputError: The disk refuses.
    """
    figures = report_pngs(diagnosis, settings=diagnosis.report)
    page = report_html(diagnosis, figures)
    gap = json.dumps(jsonable(diagnosis.as_json()), indent=2, allow_nan=False) + "\n"
    files = {"gap.html": page.encode(), "gap.json": gap.encode()}
    files |= {f"figures/{name}.png": png for name, png in figures.items()}
    mjcf = (diagnosis.patch or {}).get("mjcf")
    if mjcf:
        files["patched.xml"] = mjcf.encode()
    for name, content in files.items():
        write_whole(folder / name, content)
    return folder
