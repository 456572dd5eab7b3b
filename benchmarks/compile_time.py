"""`python -m benchmarks.compile_time`: processor time that compiling the kernels takes.

It measures a copy of the sources with a cache of its own: the simulation of a cube for the first time, and again after
an edit of the contact law; with `--all`, each task of `make setup` too. Times are of processes as a whole, imports
included.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from pipelines.cli.console import Console

SIMULATE = """
import numpy as np
from tossid.objects import load_object
from tossid.physics import make_system, simulate

start = np.array([[0, 0, 0.1, 1, 0, 0, 0.0]])
simulate(make_system(load_object("cube")), start, np.zeros((1, 6)), n_steps=1, dt=1 / 148)
"""
EDIT = ("target = phi / h + free", "target = free + phi / h")
"""A line of the contact law, and another: kernels are kept under what they do, so that it takes a line that does."""


def main() -> None:
    """Print the table."""
    console, root = Console(), Path(__file__).parents[1]
    with tempfile.TemporaryDirectory() as temporary:
        tree = Path(temporary) / "tree"
        for package in ("tossid", "pipelines"):
            shutil.copytree(root / package, tree / package, ignore=shutil.ignore_patterns("*.nb[ic]", "__pycache__"))
        imports, _ = seconds(tree, "import numpy, tossid.physics")
        first, _ = seconds(tree, SIMULATE)
        law = tree / "tossid" / "physics" / "contact" / "law.py"
        line, other = EDIT
        if line not in law.read_text():
            raise SystemExit(f"{law.name} has no line '{line}' to be edited")
        law.write_text(law.read_text().replace(line, other))
        edited, _ = seconds(tree, SIMULATE)
        rows = [("imports alone", imports), ("cube, for the first time", first), ("after an edit of law.py", edited)]
        if "--all" in sys.argv[1:]:
            shutil.rmtree(tree / "cache")
            tasks = "from pipelines import compile_kernels as c; print(*(task.__name__ for task in c.TASKS))"
            for name in seconds(tree, tasks)[1].split():
                task = f"from pipelines import compile_kernels as c; c.{name}()"
                rows.append((f"make setup: {name}", seconds(tree, task)[0]))
            rows.append(("make setup, in all", sum(took for _, took in rows[3:])))
    console.table(["processor time", "s"], [[name, f"{value:.1f}"] for name, value in rows])


def seconds(tree: Path, code: str) -> tuple[float, str]:
    """Processor time [s] of a Python process that runs code in a tree, and the last line that it prints."""
    environment = {**os.environ, "PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(tree / "cache")}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run([sys.executable, "-c", code], cwd=tree, env=environment, stdout=subprocess.PIPE, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    lines = done.stdout.decode().splitlines()
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, lines[-1] if lines else ""


if __name__ == "__main__":
    main()
