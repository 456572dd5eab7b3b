"""`make bench`: speed of the simulators beside MuJoCo's, of trainings, a study, a diagnosis and the command line.

CPU time on one thread, medians of five repetitions; what is compared runs in turns, in one process. The diagnosis is
one run of the command on all cores, whose elapsed time and memory count.
"""

from __future__ import annotations

import os
import platform
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.bench_diagnosis import diagnoses
from benchmarks.bench_studies import trainings, whole_commands
from benchmarks.bench_vision import vision
from pipelines.cli.console import Console
from tossid.objects import ObjectModel, load_object, to_mjcf
from tossid.physics import PolyhedralCone, make_system, simulate

Array = NDArray[np.float64]

DT = 1 / 148
DATA = Path("../shared/data")
DATASETS = {"cube": ("contactnets", "contactnets_cube"), "elbow": ("pll", "pll_elbow")}
"""Object: its recordings' importer, and their folder in DATA; the dataset is data/datasets/FOLDER.h5."""
TOSSES = {"cube": 500, "elbow": 120}
"""At most so many tosses of an object are simulated."""
FRAMES = 105
"""Length of a random toss: about a real one's."""
REPETITIONS = 5


class Start(NamedTuple):
    """Initial states q (B, nq), v (B, nv), the steps of each toss (B,), and where they are from."""

    q: Array
    v: Array
    n_steps: NDArray[np.int64]
    origin: str


def main() -> None:
    """Print every table."""
    console = Console()
    console.say(
        f"{cpu_model()}, {os.cpu_count()} cores; {platform.python_implementation()} {platform.python_version()}, "
        f"MuJoCo {version('mujoco')}, one thread; steps of 1/148 s"
    )
    rows = []
    tosses = {name: real_tosses(name) for name in DATASETS}
    for name in DATASETS:
        model = load_object(name)
        start = first_states(tosses[name][: TOSSES[name]]) if tosses[name] else random_states(model, 100)
        steps = int(start.n_steps.sum())
        system = make_system(model)
        exact = partial(simulate, system, start.q, start.v, n_steps=start.n_steps, dt=DT)
        polyhedral = partial(exact, solver=PolyhedralCone(n_directions=8))
        work: dict[str, Callable[[], object]] = {
            "tossid, exact cone": exact,
            "tossid, 8 directions": polyhedral,
            "mujoco.rollout": mujoco_rollout(model, start),
        }
        seconds = in_turns(work)
        runs = {"tossid, exact cone": exact(), "tossid, 8 directions": polyhedral()}
        for what, each in seconds.items():
            left = (
                [f"{runs[what].unsolved.sum():,}", f"{runs[what].kkt_error.max():.0e}"] if what in runs else ["-", "-"]
            )
            ratio = seconds["mujoco.rollout"] / each
            rows.append([name, what, f"{steps / each:,.0f}", f"{ratio:.2f}", *left, f"{steps:,}", start.origin])
    heads = ["object", "simulator", "steps/s", "to MuJoCo", "unsolved", "worst m/s", "steps", "from"]
    console.table(heads, rows, title="Simulation")
    trainings(console)
    whole_commands(console)
    vision(console)
    diagnoses(console)
    console.facts({"tossid --help": f"{help_seconds():.2f} s of CPU time"}, title="Command line")


def cpu_model() -> str:
    """The processor, as the system names it."""
    info = Path("/proc/cpuinfo")
    names = [line.partition(":")[2].strip() for line in info.read_text().splitlines() if line.startswith("model name")]
    return f"{names[0] if names else platform.processor()} ({platform.machine()})"


def real_tosses(name: str) -> list[Any]:
    """An object's real tosses, from the dataset that `make experiments` makes or from the recordings; [] without."""
    from tossid.store import read_dataset

    importer, folder = DATASETS[name]
    dataset = Path("data/datasets") / f"{folder}.h5"
    if not dataset.is_file():
        if not (DATA / folder).is_dir():
            return []
        from pipelines.cli.call import call_with_keys

        keys = [f"source={importer}", f"source.path={DATA / folder}", f"object={name}", f"out={dataset}"]
        call_with_keys("ingest", keys, json=False, quiet=True)
    return list(read_dataset(dataset).tosses)


def first_states(tosses: list[Any]) -> Start:
    """Where real tosses begin, each for its own length."""
    n_steps = np.array([len(toss.q) - 1 for toss in tosses])
    origin = f"{len(tosses)} real tosses"
    return Start(np.stack([toss.q[0] for toss in tosses]), np.stack([toss.v[0] for toss in tosses]), n_steps, origin)


def random_states(model: ObjectModel, count: int) -> Start:
    """Releases at 10 to 30 cm."""
    rng = np.random.default_rng(0)
    q, v = np.zeros((count, model.nq)), rng.normal(size=(count, model.nv))
    q[:, 2] = rng.uniform(0.1, 0.3, count)
    q[:, 3:7] = rng.normal(size=(count, 4))
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    v[:, 3:] *= 4
    return Start(q, v, np.full(count, FRAMES), f"{count} random states (no recordings in {DATA})")


def mujoco_rollout(model: ObjectModel, start: Start) -> Callable[[], object]:
    """MuJoCo's batched rollout of the same object from the same states, at the same step; one batch for each length."""
    import mujoco
    from mujoco import rollout

    scene = mujoco.MjModel.from_xml_string(to_mjcf(model, timestep=DT, solref=(2 * DT, 1.0)))
    scene.opt.timestep = DT
    data = mujoco.MjData(scene)
    initial = np.concatenate([np.zeros((len(start.q), 1)), start.q, start.v], axis=1)
    batches = [(initial[start.n_steps == length], int(length)) for length in np.unique(start.n_steps)]

    def call() -> None:
        for states, length in batches:
            rollout.rollout(scene, data, states, nstep=length)

    return call


def in_turns(work: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Median CPU seconds of each, repeated in turns after one call to warm up."""
    seconds: dict[str, list[float]] = {name: [] for name in work}
    for repetition in range(REPETITIONS + 1):
        for name, call in work.items():
            started = time.process_time()
            call()
            if repetition:
                seconds[name].append(time.process_time() - started)
    return {name: float(np.median(values)) for name, values in seconds.items()}


def help_seconds() -> float:
    """CPU seconds of `tossid --help`, in a process of its own."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-m", "pipelines.cli.app", "--help"], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


if __name__ == "__main__":
    from pipelines.cli.failures import guarded

    sys.exit(guarded(main, "bench"))
