"""Tosses simulated by MuJoCo, with contact as rigid as its soft model bears.

MuJoCo's contacts are springs and dampers in disguise (`solref`: a time constant of at least two time
steps, and a damping ratio). A corner that arrives at 3 m/s sinks in by about the way of one step or
two, so penetration is bought with short steps: less than 0.1 mm at 50 microseconds, 1 mm at 0.8 ms.
Critical damping holds for one corner in continuous time only: four corners landing at once rebound
with up to a fifth of their speed. With a damping ratio of 10 a rebound stays below 0.3 % of the
landing speed, and tosses stay half as far from those of the exact rigid contact (`stepping`).
The impedance close to 1 (`solimp`) keeps the weight at rest from pressing in, and friction from creeping.

MuJoCo's friction is the convex relaxation of Coulomb's (Anitescu 2006; Todorov 2014): a contact that
slips at speed v also leaves the ground at mu v, whatever the time step, so that a cube sliding at
1 m/s hops by 1.5 mm. Slower friction (`solreffriction`) would hide the hops, but it takes the tosses
further from Coulomb's law, since friction then comes too late in an impact; it is left as it is.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

from tossid.errors import DivergedError, MotionError
from tossid.objects import ObjectModel

Array = NDArray[np.float64]

LIFTING = 1e-4
"""`Law.lifting` [m] of the relaxed friction law, in which what slides is lifted (Anitescu, Math. Prog. 2006)."""

RIGID_STEP = 5e-5
"""Time step [s] at which a landing cube sinks in by less than 0.1 mm."""

RIGID_DAMPING = 10.0
"""Damping ratio of contact at which a landing does not bounce."""

RIGID_SOLIMP = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""MuJoCo's impedance of contact: as near 1, which is rigid, as its solver bears."""
_ROWS_AT_ONCE = 1_000_000
"""States that MuJoCo returns at once: a bound on memory, of some hundred megabytes."""
_changing = threading.Lock()
_before: list[Callable[[str], None] | None] = []
"""MuJoCo's handler of warnings as each thread found it that is within `quiet`; the first is the one to set again."""


def run_scene(
    compiled: mujoco.MjModel,
    model: ObjectModel,
    q0: Array,
    v0: Array,
    n_steps: int,
    substeps: int,
    *,
    push: Callable[[Array, Array], Array] | None = None,
    hold: int = 1,
    n_threads: int = 1,
) -> tuple[Array, Array]:
    """Run a compiled scene, whose time step is a `substeps`-th of a frame, from B states at once.

    Args:
        compiled: The scene.
        model: The object in it; its order of q and v is the scene's.
        q0: (B, nq) or (nq,) start.
        v0: (B, nv) or (nv,) start.
        n_steps: Frames after the first.
        substeps: MuJoCo steps a frame.
        push: From states q (B, nq), v (B, nv) to the force [N] and torque [N m] on each of the scene's bodies,
            (B, nbody, 6), world axes, at its centre of mass.
        hold: Time steps for which a push is held; a divisor of substeps.
        n_threads: Threads over the batch.

    Returns:
        q (B, n_steps + 1, nq) and v (B, n_steps + 1, nv), the start first, quaternions unit.

    Raises:
        MotionError: A start is not finite, or has another shape than the object's.
        DivergedError: MuJoCo gave up on a toss (it resets a state that explodes); carries the toss's start.
    """
    q0, v0 = np.atleast_2d(np.asarray(q0, dtype=float)), np.atleast_2d(np.asarray(v0, dtype=float))
    if q0.shape[1] != model.nq or v0.shape != (len(q0), model.nv):
        raise MotionError(f"start of shapes {q0.shape} and {v0.shape}, expected (B, {model.nq}) and (B, {model.nv})")
    bad = ~(np.isfinite(q0).all(axis=1) & np.isfinite(v0).all(axis=1))
    if bad.any():
        raise MotionError("start is not finite (NaN or infinity)", row=int(np.argmax(bad)))
    data = [mujoco.MjData(compiled) for _ in range(max(1, n_threads))]
    start = np.concatenate([np.zeros((len(q0), 1)), q0, v0], axis=1)
    q, v = np.empty((len(q0), n_steps + 1, model.nq)), np.empty((len(q0), n_steps + 1, model.nv))
    q[:, 0], v[:, 0] = q0, v0
    at_once = max(n_threads, _ROWS_AT_ONCE // (n_steps * substeps), 1)
    duration = n_steps * substeps * compiled.opt.timestep
    for first in range(0, len(q0), at_once):
        part = slice(first, first + at_once)
        with quiet():
            if push is None:
                states, _ = rollout.rollout(
                    compiled, data, start[part], nstep=n_steps * substeps, persistent_pool=n_threads > 1
                )
                frames = np.asarray(states)[:, substeps - 1 :: substeps]
            else:
                frames = _pushed(compiled, data, start[part], n_steps, substeps, push, hold)
        _check_reached(frames, start[part], first, duration)
        q[part, 1:], v[part, 1:] = frames[..., 1 : 1 + model.nq], frames[..., 1 + model.nq :]
    q[..., 3:7] /= np.linalg.norm(q[..., 3:7], axis=-1, keepdims=True)
    return q, v


def _pushed(
    compiled: mujoco.MjModel,
    data: list[mujoco.MjData],
    start: Array,
    n_steps: int,
    substeps: int,
    push: Callable[[Array, Array], Array],
    hold: int,
) -> Array:
    """Frames (B, n_steps, 1 + nq + nv) with forces of the state, each held for some steps."""
    nq, state = compiled.nq, start
    frames = np.empty((len(start), n_steps, start.shape[1]))
    for frame in range(n_steps):
        for _ in range(substeps // hold):
            wrench = push(state[:, 1 : 1 + nq], state[:, 1 + nq :]).reshape(len(start), 1, -1)
            states, _ = rollout.rollout(
                compiled,
                data,
                state,
                wrench,
                control_spec=int(mujoco.mjtState.mjSTATE_XFRC_APPLIED),
                nstep=hold,
                persistent_pool=len(data) > 1,
            )
            state = np.ascontiguousarray(np.asarray(states)[:, -1])
        frames[:, frame] = state
    return frames


@contextmanager
def quiet() -> Iterator[None]:
    """Keep MuJoCo's warnings out of a log file in the working directory; `_check_reached` finds what they say.

    A process has one handler of them. It is set while any thread is within, so that none waits for another's motions.
    """
    with _changing:
        _before.append(mujoco.get_mju_user_warning())
        mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        with _changing:
            handler = _before.pop()
            if not _before:
                mujoco.set_mju_user_warning(handler)


def _check_reached(frames: Array, start: Array, first: int, duration: float) -> None:
    """A toss on which MuJoCo gave up repeats a state: its clock does not reach the end."""
    lost = ~np.isfinite(frames).all(axis=(1, 2)) | (np.abs(frames[:, -1, 0] - duration) > 1e-6 * duration)
    if lost.any():
        toss = int(np.argmax(lost))
        raise DivergedError(f"toss {first + toss} diverged in MuJoCo ({int(lost.sum())} did)", state=start[toss, 1:])
