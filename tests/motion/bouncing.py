"""Tosses of known truth: MuJoCo's free flight and near-rigid bounces, and the noise of a tracker."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from tossid.objects import ObjectModel, to_mjcf
from tossid.rotations import quat_exp, quat_mul, quat_normalize
from tossid.types import PoseTrack

RATE_HZ = 148.0
POSITION_NOISE, ROTATION_NOISE = 0.15e-3, 1.5e-3


@dataclass(frozen=True)
class Truth:
    """t (n,), q (n, nq), v (n, nv), and contact (n-1,): whether the ground pushed between a frame and the next."""

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    contact: np.ndarray


def bounce(
    model: ObjectModel,
    rng: np.random.Generator,
    *,
    tosses: int,
    frames: int,
    gravity: float = 9.81,
    times: np.ndarray | None = None,
) -> list[Truth]:
    """Tosses from a quarter of a metre, with spin.

    Args:
        times: (frames,) [s] frame times, multiples of 0.5 ms; 148 Hz if None.
    """
    substeps = 14
    timestep = 1.0 / RATE_HZ / substeps if times is None else 5e-4
    m = mujoco.MjModel.from_xml_string(to_mjcf(model, timestep=timestep, gravity=gravity))
    # of fourth order: flight is exact, so that the truth's v is the derivative of its q
    m.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    d = mujoco.MjData(m)
    steps = np.full(frames - 1, substeps) if times is None else np.rint(np.diff(times) / timestep).astype(int)
    t = np.concatenate([[0.0], np.cumsum(steps * timestep)])
    out = []
    for _ in range(tosses):
        mujoco.mj_resetData(m, d)
        d.qpos[:3] = [0.0, 0.0, 0.25 + 0.1 * rng.random()]
        d.qpos[3:7] = quat_normalize(rng.normal(size=4))
        d.qvel[:3] = rng.normal(size=3) * [1.5, 1.5, 0.3]
        d.qvel[3:6] = rng.normal(size=3) * 6.0
        d.qvel[6:] = rng.normal(size=model.n_joints) * 3.0
        q, v, contact = [d.qpos.copy()], [d.qvel.copy()], []
        for count in steps:
            touched = False
            for _ in range(count):
                mujoco.mj_step(m, d)
                touched = touched or d.ncon > 0
            q.append(d.qpos.copy())
            v.append(d.qvel.copy())
            contact.append(touched)
        out.append(Truth(t, np.array(q), np.array(v), np.array(contact)))
    return out


def noisy(q: np.ndarray, rng: np.random.Generator, position: float, rotation: float) -> np.ndarray:
    """Poses (n, nq) with white noise on place [m], and on attitude and joints [rad]."""
    n, nq = q.shape
    place = q[:, :3] + position * rng.normal(size=(n, 3))
    turned = quat_normalize(quat_mul(q[:, 3:7], quat_exp(rotation * rng.normal(size=(n, 3)))))
    return np.column_stack([place, turned, q[:, 7:] + rotation * rng.normal(size=(n, nq - 7))])


def tracked(
    truth: Truth,
    rng: np.random.Generator,
    *,
    name: str = "toss",
    position: float = POSITION_NOISE,
    rotation: float = ROTATION_NOISE,
    with_cov: bool = True,
) -> PoseTrack:
    """The truth as a tracker would see it."""
    track = track_of(truth.t, truth.q, rng, (position, rotation), name=name)
    return track if with_cov else replace(track, q_cov=None)


def track_of(
    t: np.ndarray, q: np.ndarray, rng: np.random.Generator, noise: tuple[float, float], *, name: str = "recording"
) -> PoseTrack:
    """Poses at times with noise [m, rad], and its covariance."""
    sigma = np.repeat(noise, [3, q.shape[1] - 4])
    return PoseTrack(name, t, noisy(q, rng, *noise), np.tile(np.diag(sigma**2), (len(t), 1, 1)))


def jumps(truth: Truth, *, gravity: float = 9.81) -> np.ndarray:
    """(n-1,) size [m/s] of the change of velocity in each interval that neither falling nor lying explains."""
    h = np.diff(truth.t)
    step = np.diff(truth.v, axis=0)
    step[:, 2] += np.where(step[:, 2] > -0.5 * gravity * h, 0.0, gravity * h)
    return np.sqrt((step[:, :3] ** 2).sum(axis=1) + 0.047**2 * (step[:, 3:] ** 2).sum(axis=1))


def away_from_jumps(truth: Truth, size: float) -> np.ndarray:
    """(n,) frames that are no frame before, and no two frames after, a jump beyond `size` [m/s]."""
    away = np.ones(len(truth.t), dtype=bool)
    for k in np.flatnonzero(jumps(truth) > size):
        away[max(0, k - 1) : k + 3] = False
    return away
