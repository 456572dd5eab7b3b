"""The patch applied and rerun: the user's MuJoCo model against the tosses, before and after."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

from tossid.diagnosis.fitting import NU, Evidence, Hypothesis
from tossid.diagnosis.gap import CAP, bootstrap_ratio, by_toss, deviance, first_states
from tossid.diagnosis.patch import Patch
from tossid.diagnosis.windows import Windows, linearise, make_windows
from tossid.errors import InputError
from tossid.evaluation.metrics import summarize
from tossid.objects import ObjectModel, center_positions
from tossid.physics.effects import Recording, World
from tossid.physics.mujoco_engine import _quiet
from tossid.rotations import geodesic_angle, quat_conj, quat_exp, quat_mul, quat_rotate
from tossid.types import Toss

Array = NDArray[np.float64]

_ROWS_AT_ONCE = 1_000_000
MOST_STEPS = 1_200_000
"""MuJoCo steps of a rerun beyond which fewer tosses are rerun."""
LARGEST = 1e3
"""[m] beyond which a motion counts as lost."""


@dataclass(frozen=True)
class MujocoWorld:
    """A compiled MuJoCo model of one free body, with its own options, and how its motion is recorded."""

    model: mujoco.MjModel
    recording: Recording

    def roll_out(self, q0: Array, v0: Array, *, n_steps: NDArray[np.int64], dt: float, n_threads: int = 1) -> Array:
        """Recorded motions (B, T + 1, 7) from recorded first states (B, 7), (B, 6); NaN where MuJoCo gave up.

        The time step is the model's own, shortened so that a whole number of steps makes a frame.

        Raises:
            InputError: the model has more state than one free body.
        """
        m, r = self.model, self.recording
        if mujoco.mj_stateSize(m, mujoco.mjtState.mjSTATE_FULLPHYSICS) != 14 or m.nq != 7:
            raise InputError(f"the MuJoCo model has {m.nq} coordinates and actuators or plugins beside one free body")
        kept = m.opt.timestep
        count = math.ceil(dt / r.clock_rate / kept - 1e-9)
        q, v = _true_states(r, q0, v0)
        start = np.concatenate([np.zeros((len(q), 1)), q, v], axis=1)
        steps = int(np.max(n_steps))
        out = np.full((len(q), steps + 1, 7), np.nan)
        out[:, 0] = q
        data = [mujoco.MjData(m) for _ in range(max(1, n_threads))]
        at_once = max(n_threads, _ROWS_AT_ONCE // (steps * count), 1)
        try:
            m.opt.timestep = dt / r.clock_rate / count
            for first in range(0, len(q), at_once):
                part = slice(first, first + at_once)
                with _quiet():
                    states, _ = rollout.rollout(m, data, start[part], nstep=steps * count)
                frames = np.asarray(states)[:, count - 1 :: count]
                # a toss on which MuJoCo gave up begins anew: its clock falls behind
                clock = np.arange(1, steps + 1) * count * m.opt.timestep
                good = np.isfinite(frames).all(-1) & (np.abs(frames[..., 0] - clock) < 1e-6 * clock[-1])
                good &= np.abs(frames[..., 1:4]).max(-1) < LARGEST
                good = np.logical_and.accumulate(good, axis=1)
                out[part, 1:] = np.where(good[..., None], frames[..., 1:8], np.nan)
        finally:
            m.opt.timestep = kept
        return _recorded(r, out)


def _true_states(r: Recording, q0: Array, v0: Array) -> tuple[Array, Array]:
    """As `World.roll_out` has it, but for the ground, which is the model's own."""
    turn, offset = quat_exp(-np.array([*r.world_tilt, 0.0])), np.array(r.frame_offset)
    q, v = q0.copy(), v0.copy()
    q[:, 3:7] = quat_mul(turn, q0[:, 3:7])
    v[:, 3:] *= r.clock_rate
    arm, spin = quat_rotate(q[:, 3:7], offset), quat_rotate(q[:, 3:7], v[:, 3:6])
    q[:, :3] = quat_rotate(turn, q0[:, :3]) / r.length_scale - arm
    v[:, :3] = quat_rotate(turn, v0[:, :3]) * (r.clock_rate / r.length_scale) - np.cross(spin, arm)
    return q, v


def _recorded(r: Recording, q: Array) -> Array:
    """True motions (B, T, 7) as they would be recorded."""
    back, out = quat_conj(quat_exp(-np.array([*r.world_tilt, 0.0]))), q.copy()
    out[..., :3] = quat_rotate(back, q[..., :3] + quat_rotate(q[..., 3:7], np.array(r.frame_offset))) * r.length_scale
    out[..., 3:7] = quat_mul(back, q[..., 3:7])
    return out


def rerun(
    patch: Patch, hypothesis: Hypothesis, tosses: Sequence[Toss], stated: ObjectModel, *, n_threads: int = 1
) -> dict[str, Any]:
    """gap.json's "patch.rerun": how far MuJoCo's predictions miss before and after the patch.

    The gap is that of short windows, whitened as in the diagnosis: each window's first state is what its own frames
    tell under tossid's simulator with the same effects. The rollouts run over whole tosses from first states as
    flight tells them under the patched world: both runs start alike.

    Args:
        stated: the dataset's object, whose centre and width errors refer to.
    """
    worlds = {"before": hypothesis.base, "after": hypothesis.world()}
    models = {"before": patch.before, "after": patch.after}
    tosses = _affordable(tosses, min(float(model.opt.timestep) for model in models.values()))
    windows = make_windows(tosses)
    n = len(tosses)
    q0, v0 = first_states(tosses, worlds["after"])
    out: dict[str, Any] = {
        "engine": f"MuJoCo {mujoco.__version__}",
        "n_tosses": n,
        "on": "tosses that took part in the fit",
        "not_in_it": sorted(patch.not_expressed),
        "gap": {"unit": "standard deviations of noise"},
        "position_error_pct": {},
        "rotation_error_deg": {},
        "timestep_s": {},
        "lost": {},
    }
    excess = {}
    for name, model in models.items():
        simulated = MujocoWorld(model, worlds[name].recording)
        evidence, residual = _misses(windows, worlds[name], simulated, n_threads=n_threads)
        excess[name] = by_toss(evidence, _excess(evidence, residual), n)
        inside = evidence.windows.inside[..., None] * np.ones(6)
        squares = np.where(inside > 0, np.minimum(residual**2, CAP**2), 0.0)
        ratio = bootstrap_ratio(by_toss(evidence, squares, n), by_toss(evidence, inside, n))
        out["gap"][name] = {"value": math.sqrt(ratio.value), "ci95": [math.sqrt(ratio.low), math.sqrt(ratio.high)]}
        position, rotation = _rollouts(simulated, tosses, stated, q0, v0, n_threads=n_threads)
        for key, values in (("position_error_pct", position), ("rotation_error_deg", rotation)):
            mean = summarize(values)
            out[key][name] = {"value": mean["mean"], "ci95": mean["ci95"]}
        out["timestep_s"][name] = float(model.opt.timestep)
        out["lost"][name] = int((~np.isfinite(position)).sum())
    out["gap_closed"] = bootstrap_ratio(excess["before"] - excess["after"], excess["before"]).as_json()
    return out


def _excess(evidence: Evidence, residual: Array) -> Array:
    """(W, L, 6) deviance above what a standard normal has on average; 0 outside the windows."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    floor = float(weights @ _deviance_of(nodes) / weights.sum())
    return np.where(evidence.windows.inside[..., None], deviance(evidence, residual) - floor, 0.0)


def _deviance_of(r: Array) -> Array:
    value: Array = (NU + 1) * np.log1p(r**2 / NU)
    return value


def _affordable(tosses: Sequence[Toss], timestep: float) -> Sequence[Toss]:
    """All tosses, or as many of them, evenly spread, as can be run four times within `MOST_STEPS`."""
    seconds = float(np.mean([toss.t[-1] - toss.t[0] for toss in tosses]))
    most = max(6, int(MOST_STEPS * timestep / (4 * seconds)))
    return [tosses[i] for i in np.unique(np.linspace(0, len(tosses) - 1, min(most, len(tosses))).astype(int))]


def _misses(windows: Windows, world: World, simulated: MujocoWorld, *, n_threads: int) -> tuple[Evidence, Array]:
    """Whitened misses (W, L, 6) of MuJoCo in windows whose first states are refined under tossid's own simulator."""
    kept, whitening = linearise(windows, world, refine=2, n_threads=n_threads)
    length = kept.y.shape[1]
    n_steps = kept.inside.sum(1)
    run = simulated.roll_out(kept.at_q, kept.at_v, n_steps=n_steps, dt=kept.dt, n_threads=n_threads)
    evidence = Evidence(kept, whitening, n_threads)
    padded = np.full((len(run), length, 7), np.nan)
    padded[:, : run.shape[1] - 1] = run[:, 1:]
    return evidence, whitening(kept.misses(padded))


def _rollouts(
    simulated: MujocoWorld, tosses: Sequence[Toss], stated: ObjectModel, q0: Array, v0: Array, *, n_threads: int
) -> tuple[Array, Array]:
    """Mean position error [% of width] and rotation error [deg] of each toss (B,); NaN where MuJoCo gave up."""
    dt = float(np.median(np.concatenate([np.diff(toss.t) for toss in tosses])))
    steps = np.array([len(toss) - 1 for toss in tosses])
    run = simulated.roll_out(q0, v0, n_steps=steps, dt=dt, n_threads=n_threads)
    position, rotation = np.empty(len(tosses)), np.empty(len(tosses))
    for i, toss in enumerate(tosses):
        q = run[i, : len(toss)]
        far = np.linalg.norm(center_positions(stated, q) - center_positions(stated, toss.q), axis=1)
        position[i] = 100 * far.mean() / stated.width
        rotation[i] = np.rad2deg(geodesic_angle(q[:, 3:7], toss.q[:, 3:7])).mean()
    return position, rotation
