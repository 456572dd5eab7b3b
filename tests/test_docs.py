"""The documentation: its scripts run, its commands have such keys, its links and its reference are whole."""

from __future__ import annotations

import os
import re
import runpy
import shlex
import subprocess
import sys
import textwrap
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

import pytest

from pipelines.config.compose import load
from pipelines.config.schemas import COMMANDS

CLONE = Path(__file__).parents[1]
DOCS = CLONE / "docs"
PAGES = [*CLONE.glob("*.md"), *DOCS.rglob("*.md"), CLONE / "examples" / "README.md"]
EXTEND = (DOCS / "guide" / "extend.md").read_text()
SCRIPTS = {
    section.splitlines()[0]: script
    for section in EXTEND.split("\n## ")[1:]
    for script in re.findall(r"```python\n(.*?)```", section, re.DOTALL)
}

SIMULATES = {
    "An effect": (
        "dataset = tossid.synthesize(",
        """
import numpy as np
from tossid.physics.effects import World, effect_named
from tossid.physics.registered_forces import combined, wrenches_of

cube = tossid.objects.load_object("cube")
assert effects_for(cube)[-1] is pull
world = effect_named("height_pull").at(World(cube), np.array([2.0]))
state = np.array([[0.3, 0.1, 0.5]])
force, torque = wrenches_of(combined(world.registered), state, state, state)
assert force.tolist() == [[1.0, 0.0, 0.0]]
assert not torque.any()
""",
    ),
    "A contact solver": (
        "cube = make_system(",
        """
lam = np.zeros(3)  # of a particle of 0.7 kg that comes in at 1 m/s and slides at 0.5 m/s
status, error = gauss_seidel(GaussSeidel(), np.eye(3) / 0.7, np.array([-1.0, 0.5, 0.0]), np.array([0.3]), lam, 1e-10)
assert status == SolverStatus.SOLVED
assert error <= 1e-10
np.testing.assert_allclose(lam, [0.7, -0.21, 0.0], atol=1e-9)
""",
    ),
}
"""Scripts that simulate with what they register, so that the time step is compiled for it, for half a minute: where
that begins, and what the part before is tested by in its place."""


# ---------------------------------------------------------------- scripts


def runs(script: str, folder: Path, *, warnings: str = "error") -> None:
    """Run a script in a process of its own."""
    env = os.environ | {"PYTHONPATH": str(CLONE)}
    command = [sys.executable, "-W", warnings, "-c", script]
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr


def test_every_section_about_extending_has_a_script() -> None:
    assert set(SCRIPTS) == set(re.findall(r"^## (.*)$", EXTEND, re.MULTILINE))


@pytest.mark.parametrize(
    "section", [pytest.param(name, marks=pytest.mark.slow) if name in SIMULATES else name for name in SCRIPTS]
)
def test_a_script_runs_as_written(section: str, tmp_path: Path) -> None:
    runs(SCRIPTS[section], tmp_path)


@pytest.mark.parametrize("section", SIMULATES)
def test_what_a_script_registers_does_what_it_is_to_do(section: str, tmp_path: Path) -> None:
    begins, check = SIMULATES[section]
    declared, found, _ = SCRIPTS[section].partition(begins)
    assert found
    runs(declared + check, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("page", ["README.md", "docs/start/demo.md"])
def test_the_five_lines_run_on_the_sample(page: str, tmp_path: Path) -> None:
    (tmp_path / "data").symlink_to(CLONE / "data")
    (script,) = re.findall(r"^    import tossid\n(?:    .*\n|\n(?=    ))+", (CLONE / page).read_text(), re.MULTILINE)
    runs(textwrap.dedent(script), tmp_path, warnings="default")
    assert (tmp_path / "gap" / "gap.html").is_file()


# ---------------------------------------------------------------- commands


def commands() -> list[str]:
    """Each `tossid COMMAND KEY=VALUE...` that a page shows in a block, or in a cell of a table."""
    found = set()
    for page in PAGES:
        text = page.read_text().replace("\\\n", " ")
        lines = re.findall(r"^    (tossid [a-z].*)$", text, re.MULTILINE)
        found |= {line.strip() for line in lines + re.findall(r"`(tossid [a-z][^`]*)`", text)}
    return sorted(found)


MADE = {"object=mybox": "object=cube", "source=csv": "source=tum", "model=NAME": "model=cn"}
"""Members of groups that a page makes, and what stands for them."""


@pytest.mark.parametrize("line", commands())
def test_a_command_of_the_pages_has_such_keys(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    _, command, *words = shlex.split(line, comments=True)
    if command in {"COMMAND", "doctor", "info"} or not words:  # they take no keys, or a sentence names them
        return
    keys = [MADE.get(word, word) for word in words if "=" in word]
    keys += [f"sweep={name}" for option, name in pairwise(words) if option == "--sweep" and name != "NAME"]
    load(command, COMMANDS[command], keys)


def test_modules_and_targets_that_the_pages_name_exist() -> None:
    text = "\n".join(page.read_text() for page in PAGES)
    for module in set(re.findall(r"python -m ((?:experiments|benchmarks|tests|pipelines)[\w.]*)", text)):
        assert find_spec(module) is not None, module
    targets = set(re.findall(r"^([a-z-]+):", (CLONE / "Makefile").read_text(), re.MULTILINE))
    shown = re.findall(r"^    make (?:[A-Z_]+=(?:\"[^\"]*\"|\S+) )*([a-z-]+)", text, re.MULTILINE)
    assert set(shown) <= targets


# ---------------------------------------------------------------- links and the site


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(CLONE)))
def test_links_of_a_page_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text()):
        assert re.match(r"https?:|mailto:", target) or (page.parent / target).exists(), target


def test_the_site_has_an_anchor_for_each_name_of_its_reference(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    done = subprocess.run(command, cwd=CLONE, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    on_page_markdown = runpy.run_path(str(DOCS / "reference" / "public_names.py"))["on_page_markdown"]
    for page in (DOCS / "reference").glob("*.md"):
        built = (tmp_path / "reference" / f"{page.stem}.html").read_text()
        for name in re.findall(r"^::: (\S+)$", on_page_markdown(page.read_text()), re.MULTILINE):
            assert f'id="{name}"' in built, name
