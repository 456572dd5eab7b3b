"""`make bench-against COMMIT=…`: the simulator's speed, now and at an earlier commit, in turns.

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
    found[name] = int(states["n_steps"].sum()) / min(seconds[1:])
print(json.dumps(found))
"""
"""What each process runs: the names and functions that both trees have."""


def main(commit: str) -> None:
    """Print a table of steps a second, of both trees and their ratio.

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
        A row for each object: its two medians, the median ratio of the pairs, and the ratios' range.
    """
    for name, tree in trees.items():
        measured(tree, folder, name)  # compiles
    turns = [{name: measured(tree, folder, name) for name, tree in trees.items()} for _ in range(TURNS)]
    rows = []
    for each in DATASETS:
        before, now = (np.array([turn[name][each] for turn in turns]) for name in trees)
        ratio = now / before
        medians = (f"{np.median(speed):,.0f}" for speed in (before, now))
        spread = f"{ratio.min():.2f} to {ratio.max():.2f}"
        rows.append([f"{each}, steps/s", *medians, f"{np.median(ratio):.2f}", spread])
    return rows


def measured(tree: Path, folder: Path, name: str) -> dict[str, float]:
    """Steps a second by object, in a process of a tree that has Numba's cache in a folder of its own."""
    threads = dict.fromkeys(["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"], "1")
    cache = str(folder / f"cache of {name}")
    environment = {**os.environ, **threads, "PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": cache}
    command = [sys.executable, "-c", MEASURE, str(folder), *DATASETS]
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=environment, cwd=folder)
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


if __name__ == "__main__":
    from pipelines.cli.failures import guarded

    sys.exit(guarded(lambda: main("".join(sys.argv[1:2])), "bench-against"))
