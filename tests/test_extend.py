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


def test_every_section_has_a_script() -> None:
    assert set(SCRIPTS) == set(re.findall(r"^## (.*)$", PAGE, re.MULTILINE))


def runs(script: str, folder: Path) -> None:
    """Run a script in a process of its own; warnings are errors."""
    env = os.environ | {"PYTHONPATH": str(CLONE)}
    command = [sys.executable, "-W", "error", "-c", script]
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr


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


def test_links_lead_to_sections() -> None:
    headings = {re.sub(r"[^a-z0-9 ]", "", heading.lower()).replace(" ", "-") for heading in SCRIPTS}
    assert set(re.findall(r"\]\(#([a-z-]+)\)", PAGE)) <= headings
