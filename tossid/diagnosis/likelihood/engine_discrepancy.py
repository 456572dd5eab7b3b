"""Differences between engines: what two good simulators of the same rigid body disagree on is no evidence of an effect.

Rigid contact with friction is not one law but several. MuJoCo's is the convex relaxation of Coulomb's (Anitescu 2006):
what slides is also lifted, a cube at 1 m/s by 1.5 mm. Friction of an impact may be against the slip after it, or as it
turns meanwhile (`Law.impulse_parts`). Which law the tosses follow is no effect (`inference.hypothesis.ContactLaw`).

Beyond that, impacts on several corners, how far contact yields, how several corners bounce, and what torsional friction
and rolling resistance leave of sliding friction differ between engines. So each window has one more nuisance parameter
c, the multiple of the difference between the other engine and ours (both with the same body, contact and gravity) that
the residuals contain, c ~ N(0, 1). Where a user's MuJoCo model is diagnosed, with the hypothesis's changes in it, its
difference to our reading of it is expected once, c ~ N(1, 1). So what is fitted is right for the user's own engine.
Where any other simulator of a user is diagnosed, it is what is judged, and there is no other engine (`users_world`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.states import moved_pose
from tossid.diagnosis.likelihood.windows import Windows
from tossid.errors import InputError
from tossid.parallel import threads_at_hand
from tossid.physics.contact.law import Law
from tossid.physics.effects import World
from tossid.physics.effects.in_mujoco import scene
from tossid.physics.forces import Forces
from tossid.physics.mujoco_engine import quiet

if TYPE_CHECKING:
    from tossid.diagnosis.inference.hypothesis import Hypothesis

Array = NDArray[np.float64]

IMPULSE_PARTS = 8.0
"""Parts in which the impulse of an impact is found where the slip turns meanwhile; 64 move a thrown cube by 0.01 mm
three frames later."""
SUBSTEPS, BOUNCING_SUBSTEPS = 17, 68
"""MuJoCo's steps a frame for near-rigid contact; 135 give the same differences to a few percent. A bounce takes 25
steps, here 2.5 ms."""
FARTHEST = 1e3
"""[m] beyond which a motion has diverged."""
_ROWS_AT_ONCE = 1_000_000
"""States that MuJoCo returns at once: a bound on memory, of some hundred megabytes."""


@dataclass(frozen=True)
class MujocoWorld:
    """A compiled MuJoCo model of one object, with its own options and its own ground.

    Attributes:
        model: The model.
        recorded: The world whose frames relate the model's motion to the recorded one; that world's ground is the
            model's z = 0.
    """

    model: mujoco.MjModel
    recorded: World

    def roll_out(self, q0: Array, v0: Array, *, n_steps: NDArray[np.int64], dt: float, n_threads: int = 1) -> Array:
        """(B, T + 1, nq) recorded poses from recorded first states; NaN from where MuJoCo gave up.

        The time step is the model's own.

        Args:
            q0: (B, nq) first poses.
            v0: (B, nv) first velocities.
            n_steps: (B,) frames; T is the most of them.
            dt: Between frames [s].
            n_threads: Of MuJoCo.

        Raises:
            InputError: The model has another state than its object.
        """
        m, rate = self.model, self.recorded.recording.clock_rate
        nq, nv = self.recorded.object.nq, self.recorded.object.nv
        if mujoco.mj_stateSize(m, mujoco.mjtState.mjSTATE_FULLPHYSICS) != 1 + nq + nv or m.nq != nq:
            raise InputError(
                f"the MuJoCo model has more or other state than one object's {nq} coordinates and {nv} speeds"
            )

        def onward(q: Array, v: Array, n_steps: int | NDArray[np.int64], dt: float) -> tuple[Array, Array]:
            times: Array = dt * np.arange(1.0, np.max(n_steps) + 1)
            return _frames(m, np.concatenate([q, v], axis=1), times, nq, n_threads)

        run = onward(*self.recorded.to_ground(q0, v0), n_steps, dt / rate)
        return self.recorded.recorded_motions(*run, n_steps=n_steps, dt=dt / rate, onward=onward)


def _frames(m: mujoco.MjModel, first: Array, times: Array, nq: int, n_threads: int) -> tuple[Array, Array]:
    """Motions at times (T,), from first states (B, nq + nv); NaN from where MuJoCo gave up.

    MuJoCo moves a body through a time step with the velocity at its end. So does this between time steps.
    """
    h, last = m.opt.timestep, np.ceil(times / m.opt.timestep - 1e-6).astype(int)
    early = np.maximum(last * h - times, 0.0)
    early[early < 1e-6 * h] = 0.0
    out = np.full((len(first), len(times) + 1, first.shape[1]), np.nan)
    out[:, 0] = first
    start = np.concatenate([np.zeros((len(first), 1)), first], axis=1)
    data = [mujoco.MjData(m) for _ in range(threads_at_hand(max(1, n_threads)))]
    at_once = max(n_threads, _ROWS_AT_ONCE // last[-1], 1)
    for begin in range(0, len(first), at_once):
        part = slice(begin, begin + at_once)
        with quiet():
            states, _ = rollout.rollout(m, data, start[part], nstep=last[-1])
        frames = np.asarray(states)[:, last - 1]
        # where MuJoCo gives up it resets the state, and its clock falls behind
        good = np.isfinite(frames).all(-1) & (np.abs(frames[..., 0] - last * h) < 1e-6 * last[-1] * h)
        good &= np.abs(frames[..., 1:4]).max(-1) < FARTHEST
        good = np.logical_and.accumulate(good, axis=1)
        out[part, 1:] = np.where(good[..., None], frames[..., 1:], np.nan)
    q, v = out[..., :nq], out[..., nq:]
    between = 1 + np.flatnonzero(early)
    q[:, between] = moved_pose(q[:, between], -early[between - 1, None] * v[:, between])
    return q, v


@dataclass(frozen=True)
class EngineDifference:
    """The difference between another engine's predictions of windows and ours.

    Attributes:
        values: (W, L, K) theirs minus ours.
        expected: The mean of c, the multiple of it that the residuals contain.
    """

    values: Array
    expected: float

    def rows(self, index: NDArray[np.int64]) -> EngineDifference:
        """The difference of some windows.

        Args:
            index: (n,) their numbers.
        """
        return EngineDifference(self.values[index], self.expected)


@dataclass(frozen=True)
class Engine:
    """The other engine.

    Attributes:
        patched: Of a user's MuJoCo model that is diagnosed: the model with a hypothesis's changes in it, and the world
            as which that is read. None for MuJoCo with near-rigid contact, of whatever body and ground there is.
        none: Whether there is no other engine.
    """

    patched: Callable[[Hypothesis], tuple[mujoco.MjModel, World]] | None = None
    none: bool = False

    @property
    def of_user(self) -> bool:
        """Whether a user's own contact is taken as it is."""
        return self.patched is not None or self.none

    def difference(self, windows: Windows, hypothesis: Hypothesis, *, n_threads: int = 1) -> EngineDifference:
        """Its predictions minus ours, from the windows' first states of linearisation; 0 where it gave up.

        Args:
            windows: What is predicted.
            hypothesis: What predicts.
            n_threads: Of the simulators.
        """
        if self.none:
            return EngineDifference(np.zeros((*windows.inside.shape, windows.channels)), 0.0)
        if self.patched is None:
            ours = comparable(hypothesis.world())
            count = BOUNCING_SUBSTEPS if ours.object.restitution > 0 else SUBSTEPS
            other = MujocoWorld(scene(ours, windows.dt / ours.recording.clock_rate / count), ours)
            # near-rigid engines agree in flight and at rest
            compared, expected = ~(windows.free | windows.steady), 0.0
        else:
            model, ours = self.patched(hypothesis)
            # the model has its own ground
            other = MujocoWorld(model, replace(ours, ground_height=0.0, ground_tilt=(0.0, 0.0)))
            compared, expected = np.full(len(windows.steps), True), 1.0
        values = np.zeros((*windows.inside.shape, windows.channels))
        # long windows would make those of ordinary length as long
        long = windows.steps > windows.settings.windows.length
        for rows in map(np.flatnonzero, (compared & ~long, compared & long)):
            if len(rows):
                values[rows] = _difference(windows.rows(rows), ours, other, n_threads)
        return EngineDifference(values, expected)


def _difference(windows: Windows, ours: World, other: MujocoWorld, n_threads: int) -> Array:
    """(W, L, K) another engine's predictions of windows minus our own."""
    q, v, steps = windows.at_q, windows.at_v, windows.steps
    own = windows.predicted(ours, n_threads=n_threads)
    theirs = other.roll_out(q, v, n_steps=steps, dt=windows.dt, n_threads=n_threads)[:, 1:]
    diverged = ~(np.isfinite(own).all((1, 2)) & np.isfinite(theirs).all((1, 2)))
    out: Array = windows.residuals(own) - windows.residuals(theirs)
    out[diverged] = 0.0
    return out


def comparable(world: World) -> World:
    """The world's body, gravity and ground, with what both engines know of rigid contact, and no force.

    Args:
        world: Any world.
    """
    body = world.object.with_changes(compliance=0.0, relaxation=0.0, cohesion=0.0)
    own = world.law
    law = Law(lifting=own.lifting, torsional=own.torsional, rolling=own.rolling, impulse_parts=own.impulse_parts)
    return replace(world, object=body, forces=Forces(), law=law, k_res=None, registered=())
