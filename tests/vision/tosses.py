"""True tosses for the vision tests: the object thrown in MuJoCo, until it rests."""

from __future__ import annotations

import mujoco
import numpy as np

from tossid.objects import ObjectModel, to_mjcf
from tossid.rotations import quat_normalize
from tossid.types import Toss


def thrown(
    model: ObjectModel, rng: np.random.Generator, *, name: str = "toss", rate_hz: float = 148.0, longest: float = 1.6
) -> Toss:
    """One toss from release to a tenth of a second of rest."""
    scene = mujoco.MjModel.from_xml_string(to_mjcf(model, timestep=1 / (rate_hz * 8)))
    data = mujoco.MjData(scene)
    heading = rng.uniform(0, 2 * np.pi)
    speed = rng.uniform(0.5, 1.5)
    # thrown across the middle of the area, so that it stays in view
    data.qpos[:2] = -0.3 * speed * np.array([np.cos(heading), np.sin(heading)]) + rng.uniform(-0.1, 0.1, 2)
    data.qpos[2] = rng.uniform(0.18, 0.4)
    data.qpos[3:7] = quat_normalize(rng.normal(size=4))
    data.qvel[:3] = [speed * np.cos(heading), speed * np.sin(heading), rng.uniform(-0.5, 0.8)]
    data.qvel[3:6] = rng.uniform(-6, 6, 3)
    q, v, quiet = [], [], 0
    for _ in range(int(longest * rate_hz)):
        q.append(data.qpos.copy())
        v.append(data.qvel.copy())
        mujoco.mj_step(scene, data, nstep=8)
        quiet = quiet + 1 if np.abs(data.qvel).max() < 0.005 else 0
        if quiet > 0.1 * rate_hz:
            break
    n, nv = len(q), model.nv
    t = np.arange(n) / rate_hz
    cov = np.zeros((n, nv, nv))
    return Toss(name, t, np.array(q), np.array(v), cov, cov, np.zeros(n, dtype=np.uint8))
