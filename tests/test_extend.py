"""docs/extend.md runs as it is written: each of its scripts, in a process and an empty folder of its own."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

CLONE = Path(__file__).parents[1]
PAGE = (CLONE / "docs" / "extend.md").read_text()
SCRIPTS = {
    section.splitlines()[0]: script
    for section in PAGE.split("\n## ")[1:]
    for script in re.findall(r"```python\n(.*?)```", section, re.DOTALL)
}


def test_every_section_has_a_script() -> None:
    assert set(SCRIPTS) == set(re.findall(r"^## (.*)$", PAGE, re.MULTILINE))


@pytest.mark.parametrize("section", SCRIPTS)
def test_a_script_runs_as_written(section: str, tmp_path: Path) -> None:
    env = os.environ | {"PYTHONPATH": str(CLONE)}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", SCRIPTS[section]],
        cwd=tmp_path,
        env=env,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr


def test_links_lead_to_sections() -> None:
    headings = {re.sub(r"[^a-z0-9 ]", "", heading.lower()).replace(" ", "-") for heading in SCRIPTS}
    assert set(re.findall(r"\]\(#([a-z-]+)\)", PAGE)) <= headings
