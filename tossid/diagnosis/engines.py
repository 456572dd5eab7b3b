"""Other engines' contact: what two good simulators of the same rigid body disagree on is not evidence of an effect.

Rigid contact with friction is not one law but several. MuJoCo's is the convex relaxation of Coulomb's (Anitescu 2006):
what slips also lifts off, a cube that slides at 1 m/s by 1.5 mm. Which of the two the tosses follow is found out before
any effect is looked for (`LIFTING`, in tossid's own simulator), and is no effect. Beyond that, impacts on several
corners, how much contact gives way, how several corners bounce, and what torsional friction and rolling resistance
leave of sliding friction are an engine's own. So each window has one nuisance more, c: how many times the difference
between another engine and ours, both with the same body, contact and gravity, is in the misses, c ~ N(0, 1).
Where a MuJoCo model is asked about, its difference to our reading of it is expected once, c ~ N(1, 1).
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

from tossid.diagnosis.windows import LENGTH, SAME, Windows
from tossid.errors import InputError
from tossid.physics.effects import World
from tossid.physics.effects.in_mujoco import scene
from tossid.physics.forces import Forces, Law
from tossid.physics.mujoco_engine import quiet

Array = NDArray[np.float64]

LIFTING = 1e-4
"""[m] `Law.lifting` of tosses that follow the relaxed law."""
NEAR_RIGID_SUBSTEPS = 17
"""MuJoCo steps a frame of near-rigid contact; 135 give differences that are the same to a few percent."""
BOUNCING_SUBSTEPS = 68
"""The same where contact bounces: it takes 25 steps, here 2.5 ms, and is that much softer."""
MOVED = 0.2
"""Share of an engine's difference by which our predictions may move, and it is still taken for the same."""
LARGEST = 1e3
"""[m] beyond which a motion counts as lost."""
_ROWS_AT_ONCE = 1_000_000


@dataclass(frozen=True)
class MujocoWorld:
    """A compiled MuJoCo model of one object, with its own options and its own ground.

    recorded: the world whose frames tie its motion to the recorded one; that world's ground is the model's z = 0.
    """

    model: mujoco.MjModel
    recorded: World

    def roll_out(self, q0: Array, v0: Array, *, n_steps: NDArray[np.int64], dt: float, n_threads: int = 1) -> Array:
        """Recorded motions (B, T + 1, nq) from recorded first states (B, nq), (B, nv); NaN where MuJoCo gave up.

        The time step is the model's own, shortened so that a whole number of steps makes a frame.

        Raises:
            InputError: the model has another state than its object.
        """
        m, rate = copy.copy(self.model), self.recorded.recording.clock_rate
        nq, nv = self.recorded.object.nq, self.recorded.object.nv
        if mujoco.mj_stateSize(m, mujoco.mjtState.mjSTATE_FULLPHYSICS) != 1 + nq + nv or m.nq != nq:
            raise InputError(
                f"the MuJoCo model has more or other state than one object's {nq} coordinates and {nv} speeds"
            )
        count = math.ceil(dt / rate / m.opt.timestep - 1e-9)
        m.opt.timestep = dt / rate / count
        q, v = self.recorded.to_ground(q0, v0)
        start = np.concatenate([np.zeros((len(q), 1)), q, v], axis=1)
        steps = int(np.max(n_steps))
        out = np.full((len(q), steps + 1, nq), np.nan)
        out[:, 0] = q
        data = [mujoco.MjData(m) for _ in range(max(1, n_threads))]
        at_once = max(n_threads, _ROWS_AT_ONCE // (steps * count), 1)
        for first in range(0, len(q), at_once):
            part = slice(first, first + at_once)
            with quiet():
                states, _ = rollout.rollout(m, data, start[part], nstep=steps * count)
            frames = np.asarray(states)[:, count - 1 :: count]
            # a toss on which MuJoCo gave up begins anew: its clock falls behind
            clock = np.arange(1, steps + 1) * count * m.opt.timestep
            good = np.isfinite(frames).all(-1) & (np.abs(frames[..., 0] - clock) < 1e-6 * clock[-1])
            good &= np.abs(frames[..., 1:4]).max(-1) < LARGEST
            good = np.logical_and.accumulate(good, axis=1)
            out[part, 1:] = np.where(good[..., None], frames[..., 1 : 1 + nq], np.nan)
        return self.recorded.recorded_poses(out)


@dataclass(frozen=True)
class Difference:
    """How another engine's predictions of windows differ from ours.

    values (W, L, K): the difference; expected: how many times it is in the misses, on average. ours (W, L, K): our
    misses, of the same rigid contact, where it was taken.
    """

    values: Array
    expected: float
    ours: Array

    def rows(self, index: NDArray[np.int64]) -> Difference:
        """That of some windows."""
        return Difference(self.values[index], self.expected, self.ours[index])


@dataclass(frozen=True)
class Engine:
    """The other engine. model: a MuJoCo model that is asked about, with the world that it is read as; None: MuJoCo
    with contact as rigid as it bears, of whatever body and ground are at hand."""

    model: mujoco.MjModel | None = None
    world: World | None = None

    @property
    def expected(self) -> float:
        """The mean of c."""
        return 0.0 if self.model is None else 1.0

    def difference(
        self, windows: Windows, world: World, known: Difference | None = None, *, n_threads: int = 1
    ) -> Difference:
        """Its predictions less ours, from the windows' states of linearisation; 0 where it gave up.

        Args:
            known: of a world and states near by, which stays where our own predictions have hardly moved.
        """
        if self.model is None or self.world is None:
            ours = comparable(world)
            count = BOUNCING_SUBSTEPS if ours.object.restitution > 0 else NEAR_RIGID_SUBSTEPS
            step = windows.dt / ours.recording.clock_rate / count
            other = MujocoWorld(scene(ours, step), ours)
        else:
            # its own ground is in the model
            ours = replace(self.world, recording=world.recording)
            other = MujocoWorld(self.model, replace(ours, ground_height=0.0, ground_tilt=(0.0, 0.0)))
        (W, L), K = windows.inside.shape, windows.channels
        values, misses = np.zeros((W, L, K)), np.zeros((W, L, K))
        # one flight or rest is as good as another, but for what a user's model has in it
        asked = np.full(W, self.model is not None) | ~(windows.free | windows.steady)
        for some in (asked & (windows.steps <= LENGTH), asked & (windows.steps > LENGTH)):
            rows = np.flatnonzero(some)
            if not len(rows):
                continue
            here = windows.rows(rows)
            own = here.predicted(ours, n_threads=n_threads)
            misses[rows] = here.misses(own)
            if known is not None:
                values[rows] = known.values[rows]
                moved = (np.abs(misses[rows] - known.ours[rows]) / here.noise).max((1, 2))
                anew = moved > np.maximum(SAME, MOVED * (np.abs(known.values[rows]) / here.noise).max((1, 2)))
                misses[rows[~anew]] = known.ours[rows[~anew]]
                rows, own = rows[anew], own[anew]
            if len(rows):
                values[rows] = _difference(windows.rows(rows), own, misses[rows], other, n_threads)
        return Difference(values, self.expected, misses)


def _difference(windows: Windows, own: Array, misses: Array, other: MujocoWorld, n_threads: int) -> Array:
    """(W, L, K) of windows, given our own predictions (W, F, K + 1) and what they miss (W, L, K)."""
    q, v, steps, dt = windows.at_q, windows.at_v, windows.steps, windows.dt
    theirs = other.roll_out(q, v, n_steps=steps, dt=dt, n_threads=n_threads)[:, 1:]
    lost = ~(np.isfinite(own).all((1, 2)) & np.isfinite(theirs).all((1, 2)))
    out: Array = misses - windows.misses(theirs)
    out[lost] = 0.0
    return out


def comparable(world: World) -> World:
    """The world's body, gravity and ground, with what both engines know of contact that does not give way, and no
    force."""
    body = world.object.with_changes(compliance=0.0, relaxation=0.0, cohesion=0.0)
    law = Law(lifting=world.law.lifting, torsional=world.law.torsional, rolling=world.law.rolling)
    return replace(world, object=body, forces=Forces(), law=law, residual=None)
