"""`make bench`: speed of the simulators beside MuJoCo's, of training and of the command line.

CPU time on one thread, medians of five repetitions; what is compared runs in turns, in one process.
"""

from __future__ import annotations

import platform
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.console import Console
from pipelines.project import load_object, object_named
from tossid.objects import ObjectModel, to_mjcf
from tossid.physics import make_system, simulate

DT = 1 / 148
RECORDINGS = Path("../shared/data/contactnets_cube")
DATASET = Path("data/datasets/contactnets_cube.h5")
FRAMES = 105
"""Length of a rollout: about a real toss's."""
REPETITIONS = 5


def main() -> None:
    """Print every table."""
    console = Console()
    cube, elbow = (load_object(object_named(name)) for name in ("cube", "elbow"))
    tosses = real_tosses(cube)
    if tosses:
        q, v = np.stack([toss.q[0] for toss in tosses]), np.stack([toss.v[0] for toss in tosses])
        origin = f"first states of {len(tosses)} real tosses"
    else:
        q, v = random_states(cube, 400)
        origin = f"400 random states ({RECORDINGS} is not there)"
    machine = f"{platform.machine()}, {platform.python_implementation()} {platform.python_version()}, one thread"
    console.say(f"{machine}; {FRAMES} frames of 1/148 s from each initial state")
    rows = []
    for name, model, states, about in (
        ("cube", cube, (q, v), origin),
        ("elbow", elbow, random_states(elbow, 100), "100 random states"),
    ):
        steps = len(states[0]) * FRAMES
        system = make_system(model)
        work: dict[str, Callable[[], object]] = {
            "tossid, exact cone": partial(simulate, system, *states, n_steps=FRAMES, dt=DT),
            "tossid, 8 directions": partial(simulate, system, *states, n_steps=FRAMES, dt=DT, n_directions=8),
            "mujoco.rollout": mujoco_rollout(model, *states),
        }
        seconds = in_turns(work)
        for what, each in seconds.items():
            ratio = seconds["mujoco.rollout"] / each
            rows.append([name, what, f"{steps / each:,.0f}", f"{ratio:.2f}", about])
    console.table(["object", "simulator", "steps/s", "ratio to MuJoCo", "from"], rows, title="Simulation")
    console.table(["model", "µs a transition", "transitions", "data"], training(cube, tosses), title="A training epoch")
    console.facts({"tossid --help": f"{help_seconds():.2f} s of CPU time"}, title="Command line")


def real_tosses(cube: ObjectModel) -> list[Any]:
    """The real cube's tosses, from the dataset that `make experiments` makes or from the recordings; [] without."""
    from tossid.store import read_dataset

    if not DATASET.is_file():
        if not RECORDINGS.is_dir():
            return []
        from pipelines.calling import call_with_keys

        keys = ["source=contactnets", f"source.path={RECORDINGS}", "object=cube", f"out={DATASET}"]
        call_with_keys("ingest", keys, json=False, quiet=True)
    return list(read_dataset(DATASET).tosses)


def random_states(model: ObjectModel, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Releases at 10 to 30 cm: q (count, nq), v (count, nv)."""
    rng = np.random.default_rng(0)
    q, v = np.zeros((count, model.nq)), rng.normal(size=(count, model.nv))
    q[:, 2] = rng.uniform(0.1, 0.3, count)
    q[:, 3:7] = rng.normal(size=(count, 4))
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    v[:, 3:] *= 4
    return q, v


def mujoco_rollout(model: ObjectModel, q: np.ndarray, v: np.ndarray) -> Callable[[], object]:
    """MuJoCo's batched rollout of the same object from the same states, at the same step."""
    import mujoco
    from mujoco import rollout

    scene = mujoco.MjModel.from_xml_string(to_mjcf(model, timestep=DT, solref=(2 * DT, 1.0)))
    scene.opt.timestep = DT
    data = mujoco.MjData(scene)
    initial = np.concatenate([np.zeros((len(q), 1)), q, v], axis=1)
    return lambda: rollout.rollout(scene, data, initial, nstep=FRAMES)


def training(cube: ObjectModel, tosses: list[Any]) -> list[list[str]]:
    """Rows: a pass (loss and gradient) over the training tosses, for each model that the implicit loss trains."""
    import torch

    from pipelines.checkpoints import build_model
    from pipelines.config import load
    from pipelines.schemas import TrainConfig
    from tossid.models.transitions import make_transitions

    torch.set_num_threads(1)
    chosen = [toss for toss in tosses if toss.split == "train"]
    if not chosen:
        return [["-", "-", "-", f"{RECORDINGS} is not there"]]
    transitions = make_transitions(cube, chosen)
    rows = []
    for name in ("cn", "cnrpi"):
        model = build_model(load("train", TrainConfig, [f"model={name}"]).model, cube, seed=0)
        parameters = model.stage_parameters("contact")

        def epoch(model: Any = model, parameters: Any = parameters) -> None:
            torch.autograd.grad(model.loss(transitions)[0], parameters)

        seconds = in_turns({name: epoch})[name]
        rows.append(
            [name, f"{1e6 * seconds / len(transitions):.1f}", f"{len(transitions):,}", f"{len(chosen)} real tosses"]
        )
    return rows


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
    subprocess.run([sys.executable, "-m", "pipelines.app", "--help"], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


if __name__ == "__main__":
    from pipelines.failures import guarded

    sys.exit(guarded(main, "bench"))
