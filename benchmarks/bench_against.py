"""`make bench-against COMMIT=…`: the simulator's speed and compile time, now and at an earlier commit, in turns.

Each measurement is a process of its own on one thread: the two trees take turns, so that a machine whose speed drifts
treats them alike. Both simulate the same objects (as MJCF) from the same first states.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bench import DATASETS, DT, TOSSES, cpu_model, first_states, random_states, real_tosses
from pipelines.cli.console import Console
from tossid.errors import InputError
from tossid.objects import load_object, to_mjcf

TURNS = 7
"""Processes of each tree."""
REPETITIONS = 5
"""Simulations in a process; the fastest counts, since what else runs on the machine only adds time."""

MEASURE = """
import json, sys, time
import numpy as np
from tossid.objects import object_from_mjcf
from tossid.physics import make_system, simulate

found = {}
for name in sys.argv[2:]:
    states = np.load(f"{sys.argv[1]}/{name}.npz")
    system = make_system(object_from_mjcf(open(f"{sys.argv[1]}/{name}.xml").read()))
    seconds = []
    for _ in range(1 + int(states["repetitions"])):
        started = time.process_time()
        simulate(system, states["q"], states["v"], n_steps=states["n_steps"], dt=float(states["dt"]))
        seconds.append(time.process_time() - started)
    found[name] = {"first": seconds[0], "fastest": min(seconds[1:]), "steps": int(states["n_steps"].sum())}
print(json.dumps(found))
"""
"""What each process runs: the names and functions that both trees have."""


def main(commit: str) -> None:
    """Print a table of steps a second and of the first call's CPU time, of both trees and their ratio.

    Args:
        commit: What the working tree is compared with, as git names it.
    """
    if not commit:
        raise InputError("no commit to compare with; expected make COMMIT=NAME bench-against")
    console = Console()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        write_states(folder)
        before = folder / "before"
        subprocess.run(["git", "worktree", "add", "--detach", str(before), commit], check=True, capture_output=True)
        try:
            rows = compare({commit: before, "now": Path.cwd()}, folder)
        finally:
            subprocess.run(["git", "worktree", "remove", "--force", str(before)], check=True, capture_output=True)
    console.say(f"{cpu_model()}, {os.cpu_count()} cores, one thread; medians of {TURNS} pairs of processes")
    console.table(["", commit, "now", "ratio", "smallest to largest"], rows)


def write_states(folder: Path) -> None:
    """Write each object as MJCF and the first states of its tosses as npz."""
    for name in DATASETS:
        model = load_object(name)
        tosses = real_tosses(name)[: TOSSES[name]]
        start = first_states(tosses) if tosses else random_states(model, 100)
        (folder / f"{name}.xml").write_text(to_mjcf(model))
        np.savez(folder / f"{name}.npz", q=start.q, v=start.v, n_steps=start.n_steps, dt=DT, repetitions=REPETITIONS)


def compare(trees: dict[str, Path], folder: Path) -> list[list[str]]:
    """Measure the trees in turns.

    Args:
        trees: The earlier tree, then the present one, by name.
        folder: Where the objects and their states are.

    Returns:
        Rows of what was measured, its two medians, the median ratio of the pairs, and the ratios' range.
    """
    first, second = trees
    compiled: dict[str, list[dict[str, Any]]] = {name: [] for name in trees}
    repeated: dict[str, list[dict[str, Any]]] = {name: [] for name in trees}
    for turn in range(TURNS):
        for name, tree in trees.items():
            if turn < 3:
                with tempfile.TemporaryDirectory() as cache:
                    one_by_one = [measured(tree, folder, Path(cache), [each]) for each in DATASETS]
                compiled[name].append({k: v for found in one_by_one for k, v in found.items()})
            warm = folder / f"cache of {name}"
            if turn == 0:
                measured(tree, folder, warm, list(DATASETS))
            repeated[name].append(measured(tree, folder, warm, list(DATASETS)))
    rows = []
    for each in DATASETS:
        speeds = {
            name: np.array([run[each]["steps"] / run[each]["fastest"] for run in repeated[name]]) for name in trees
        }
        rows.append(row(f"{each}, steps/s", speeds[first], speeds[second], "{:,.0f}"))
    for each in DATASETS:
        times = {name: np.array([run[each]["first"] for run in compiled[name]]) for name in trees}
        rows.append(row(f"{each}, first call [s]", times[first], times[second], "{:.1f}"))
    return rows


def row(what: str, before: np.ndarray, now: np.ndarray, form: str) -> list[str]:
    """One row of the table: medians and the pairs' ratios."""
    ratio = now / before
    spread = f"{ratio.min():.2f} to {ratio.max():.2f}"
    return [what, form.format(np.median(before)), form.format(np.median(now)), f"{np.median(ratio):.2f}", spread]


def measured(tree: Path, folder: Path, cache: Path, names: list[str]) -> dict[str, Any]:
    """What one process of a tree measures, with Numba's cache in a folder of its own."""
    threads = dict.fromkeys(["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"], "1")
    environment = {**os.environ, **threads, "PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(cache)}
    cache.mkdir(exist_ok=True)
    command = [sys.executable, "-c", MEASURE, str(folder), *names]
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=environment, cwd=folder)
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


if __name__ == "__main__":
    from pipelines.cli.failures import guarded

    sys.exit(guarded(lambda: main("".join(sys.argv[1:2])), "bench-against"))
