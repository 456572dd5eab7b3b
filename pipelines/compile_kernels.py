"""`make setup` ends with this: the kernels are compiled now, so that no first command has to wait for them.

Each task calls the library's verbs on a few short tosses, which compiles what they need for the types that they have.
Compiled kernels lie beside the sources, or where NUMBA_CACHE_DIR says, and stay valid until a source changes.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from multiprocessing import get_context

import numpy as np

import tossid
from pipelines.cli.console import Console
from tossid.objects import load_object
from tossid.physics import PolyhedralCone, make_system, simulate


def of_a_cube() -> None:
    """What tosses of a rigid body need: simulation, training, rollouts, diagnosis."""
    dataset = tossid.synthesize("cube", engine="lcp", tosses=4, seconds=0.4)
    model = tossid.train(dataset, model="cnrpi", epochs=1, patience=1)
    tossid.evaluate(model, dataset)
    tossid.diagnose(dataset, repeats=0)


def of_an_elbow() -> None:
    """What tosses of a tree need: simulation, training, rollouts."""
    dataset = tossid.synthesize("elbow", engine="mujoco", tosses=8)
    model = tossid.train(dataset, model="cnrp", epochs=1, patience=1)
    tossid.evaluate(model, dataset)


def of_films() -> None:
    """What films need: rendering with a textured ground, detection, tracking."""
    with tempfile.TemporaryDirectory() as folder:
        tossid.synthesize("cube", frames=True, tosses=1, seconds=0.4, texture=25.0, out=f"{folder}/film")
        tossid.ingest(f"{folder}/film")


def of_other_contact() -> None:
    """What the presets' polyhedral cone needs: simulation."""
    pose, velocity = np.array([[0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0]]), np.zeros((1, 6))
    simulate(make_system(load_object("cube")), pose, velocity, n_steps=1, dt=1 / 148, solver=PolyhedralCone())


TASKS: tuple[Callable[[], None], ...] = (of_a_cube, of_an_elbow, of_films, of_other_contact)
"""Each in a process of its own."""
EVERY_S = 8.0
"""Longest time between two lines about it [s]."""


def main() -> None:
    """Compile all kernels, by as many processes as there are tasks."""
    console, started = Console(), time.perf_counter()
    with ProcessPoolExecutor(len(TASKS), mp_context=get_context("spawn")) as workers:
        left = {workers.submit(task) for task in TASKS}
        while left:
            done, left = wait(left, timeout=EVERY_S, return_when=FIRST_COMPLETED)
            for task in done:
                task.result()
            parts = f"{len(TASKS) - len(left)} of {len(TASKS)} parts"
            console.say(f"compiling kernels: {parts} in {time.perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main()
