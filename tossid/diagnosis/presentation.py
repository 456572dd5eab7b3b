"""A diagnosis as it is shown and saved: a few lines, a notebook's HTML, and the report's files."""

from __future__ import annotations

import json
from pathlib import Path

from tossid.diagnosis.patch.make import ASSETS
from tossid.diagnosis.report import card_of, report_html, report_notebook, report_pngs
from tossid.diagnosis.result import Diagnosis
from tossid.outputs import write_whole
from tossid.plain_json import jsonable


def summary(diagnosis: Diagnosis) -> str:
    """The card of a diagnosis in lines of text.

    Args:
        diagnosis: What `diagnose` returned.
    """
    return str(card_of(diagnosis))


def notebook_html(diagnosis: Diagnosis) -> str:
    """The card and the main figures, and all details folded.

    Args:
        diagnosis: What `diagnose` returned.
    """
    return report_notebook(diagnosis, report_pngs(diagnosis))


def save(diagnosis: Diagnosis, folder: Path) -> Path:
    """Write gap.html, gap.json, figures/ and, where the patch has one, patched.xml with the files that it names.

    Args:
        diagnosis: What `diagnose` returned.
        folder: Where to; made if it is not there.

    Returns:
        The folder.

    Raises:
        OutputError: The disk refuses.
    """
    figures = report_pngs(diagnosis)
    page = report_html(diagnosis, figures)
    gap = json.dumps(jsonable(diagnosis.as_json()), indent=2, allow_nan=False) + "\n"
    files = {"gap.html": page.encode(), "gap.json": gap.encode()}
    files |= {f"figures/{name}.png": png for name, png in figures.items()}
    patch = diagnosis.patch or {}
    if patch.get("mjcf"):
        files["patched.xml"] = patch["mjcf"].encode()
        files |= {f"{ASSETS}/{name}": Path(source).read_bytes() for name, source in patch.get("assets", {}).items()}
    for name, content in files.items():
        write_whole(folder / name, content)
    return folder
