"""True tosses for the vision tests: the object thrown in MuJoCo, until it rests."""

from __future__ import annotations

import mujoco
import numpy as np

from tossid.objects import ObjectModel, to_mjcf
from tossid.rotations import quat_normalize
from tossid.types import Toss

SUBSTEPS = 8
"""Of MuJoCo in a frame."""


def settled(
    scene: mujoco.MjModel, q: np.ndarray, v: np.ndarray, *, longest: float = 2.0, rate_hz: float = 148.0
) -> tuple[np.ndarray, np.ndarray]:
    """Left alone until it has lain still for a tenth of a second, or for so long [s]: q (n, nq), v (n, nv)."""
    data, quiet = mujoco.MjData(scene), 0
    data.qpos[:], data.qvel[:] = q, v
    states, speeds = [], []
    for _ in range(int(longest * rate_hz)):
        states.append(data.qpos.copy())
        speeds.append(data.qvel.copy())
        mujoco.mj_step(scene, data, nstep=SUBSTEPS)
        quiet = quiet + 1 if np.abs(data.qvel).max() < 0.005 else 0
        if quiet > 0.1 * rate_hz:
            break
    return np.array(states), np.array(speeds)


def thrown(
    model: ObjectModel, rng: np.random.Generator, *, name: str = "toss", rate_hz: float = 148.0, longest: float = 1.6
) -> Toss:
    """One toss from release to a tenth of a second of rest."""
    scene = mujoco.MjModel.from_xml_string(to_mjcf(model, timestep=1 / (rate_hz * SUBSTEPS)))
    q, v, heading = np.zeros(model.nq), np.zeros(model.nv), rng.uniform(0, 2 * np.pi)
    speed, forward = rng.uniform(0.5, 1.5), np.array([np.cos(heading), np.sin(heading)])
    q[:2] = -0.3 * speed * forward + rng.uniform(-0.1, 0.1, 2)  # across the middle of the area, to stay in view
    q[2], q[3:7] = rng.uniform(0.18, 0.4), quat_normalize(rng.normal(size=4))
    v[:3], v[3:6] = [*speed * forward, rng.uniform(-0.5, 0.8)], rng.uniform(-6, 6, 3)
    q, v = settled(scene, q, v, longest=longest, rate_hz=rate_hz)
    cov = np.zeros((len(q), model.nv, model.nv))
    return Toss(name, np.arange(len(q)) / rate_hz, q, v, cov, cov, np.zeros(len(q), dtype=np.uint8))
