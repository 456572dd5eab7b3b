"""The scheme's page: its section on a law of one's own runs as written; plain Python runs the same scheme."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np

from tests.conftest import ROOT
from tests.copied import Copy

PAGE = (ROOT / "docs" / "method" / "scheme.md").read_text()
TOSS = """
import sys
import numpy as np
from tossid.objects import load_object
from tossid.physics import make_system, simulate
for name, height in (("cube", 0.12), ("elbow", 0.07)):
    model = load_object(name)
    q, v = np.zeros((2, model.nq)), np.zeros((2, model.nv))
    q[:, 2:7] = height, 0.85, 0.35, 0.25, 0.3
    q[:, 3:7] /= np.linalg.norm(q[0, 3:7])
    v[:, :6] = [0.7, 0.2, -1.2, 3.0, -5.0, 2.0]
    runs = [simulate(make_system(model), q, v, n_steps=8, dt=1 / 148, impact_parts=parts) for parts in (1, 8)]
    assert all((run.lam_n > 0).any() for run in runs)
    np.save(f"{sys.argv[1]}/{name}.npy", [run.q for run in runs])
"""


def run(folder: Path, *, compiled: bool) -> None:
    env = os.environ | {"PYTHONPATH": str(ROOT), "NUMBA_DISABLE_JIT": "0" if compiled else "1"}
    folder.mkdir()
    subprocess.run([sys.executable, "-c", TOSS, str(folder)], env=env, check=True, capture_output=True)


def test_plain_python_tosses_as_compiled_kernels_do(tmp_path: Path) -> None:
    for compiled in (True, False):
        run(tmp_path / str(compiled), compiled=compiled)
    for name in ("cube", "elbow"):
        compiled, plain = (np.load(tmp_path / folder / f"{name}.npy") for folder in ("True", "False"))
        np.testing.assert_allclose(plain, compiled, rtol=0, atol=1e-8)


def test_a_law_of_ones_own_is_one_change_of_one_file(tmp_path: Path) -> None:
    section = PAGE[PAGE.index("## Change the contact law") :]
    (change,), (check,) = (re.findall(rf"```{kind}\n(.*?)```", section, re.DOTALL) for kind in ("diff", "python"))
    copy = Copy(tmp_path)
    done = subprocess.run(["patch", "-p1"], input=change, cwd=tmp_path, text=True, capture_output=True)
    assert done.returncode == 0, done.stdout + done.stderr
    copy.python("import os; os.environ['NUMBA_DISABLE_JIT'] = '1'\n" + check)
