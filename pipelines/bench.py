"""`make bench`: speed of the simulator beside MuJoCo's, and of training. One thread, one run, CPU time."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np

from pipelines.console import Console
from pipelines.project import load_object, object_named
from tossid.objects import to_mjcf
from tossid.physics import make_system, simulate

DT = 1 / 148
STEPS = 100
COUNT = 400


def main() -> int:
    """Print steps a second of both simulators at the same time step, from the same initial states."""
    import mujoco
    from mujoco import rollout

    console = Console()
    cube = load_object(object_named("cube"))
    rng = np.random.default_rng(0)
    q = np.zeros((COUNT, 7))
    q[:, 2] = rng.uniform(0.1, 0.3, COUNT)
    q[:, 3:] = rng.normal(size=(COUNT, 4))
    q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1, keepdims=True)
    v = np.concatenate([rng.normal(size=(COUNT, 3)), 4 * rng.normal(size=(COUNT, 3))], axis=1)
    system = make_system(cube)
    scene = mujoco.MjModel.from_xml_string(to_mjcf(cube, timestep=DT, solref=(2 * DT, 1.0)))
    scene.opt.timestep = DT
    data = mujoco.MjData(scene)
    initial = np.concatenate([np.zeros((COUNT, 1)), q, v], axis=1)

    def ours() -> None:
        simulate(system, q, v, n_steps=STEPS, dt=DT)

    def theirs() -> None:
        rollout.rollout(scene, data, initial, nstep=STEPS)

    speeds = {"tossid": _rate(ours), "mujoco.rollout": _rate(theirs)}
    rows = [[name, f"{speed:,.0f}"] for name, speed in speeds.items()]
    rows.append(["ratio", f"{speeds['tossid'] / speeds['mujoco.rollout']:.2f}"])
    console.table(["simulator", "cube steps a second"], rows, title="one thread, 148 Hz, the same initial states")
    return 0


def _rate(work: Callable[[], None]) -> float:
    """Median steps a second of five repetitions, after one to warm up."""
    work()
    times = []
    for _ in range(5):
        started = time.process_time()
        work()
        times.append(time.process_time() - started)
    return COUNT * STEPS / float(np.median(times))


if __name__ == "__main__":
    sys.exit(main())
