"""What effects change in one frame of a user's simulator, from the state that it has reached.

Changes of whole motions cannot be added in contact: motions diverge there, and contact begins at other times. Changes
of one frame can. With theirs for a frame of the user's simulator, ours for one of the stated object without and with
effects θ, and free for the difference of these two in the air, a motion goes on as

    x' = theirs(x) + free(x, θ) + r (ours(x, θ) - ours(x, none) - free(x, θ))

which is a splitting of the dynamics (Hairer, Lubich and Wanner, "Geometric Numerical Integration", II.5). r is the
vertical impulse of contact in theirs over that in ours: contact is never quite the same. Where theirs is soft, an
impact takes several frames, in each of which rigid contact would stop it whole. Where theirs acts at some distance from
the ground, ours is brought to touch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.states import difference, moved_pose
from tossid.objects import corner_heights
from tossid.physics import System, simulate
from tossid.physics.effects import World
from tossid.physics.effects.wrenches import body_motions
from tossid.rotations import quat_rotate

Array = NDArray[np.float64]

MOST_IMPULSE = 3.0
"""Largest r."""
FEWEST_IMPULSE = 0.3
"""r's inverse below which ours hardly has the contact that theirs has, and is brought to touch."""
NEAR_GROUND = 5e-3
"""Height of the lowest corner [m] beyond which what moves theirs otherwise is no contact."""
LEAST_IMPULSE = 0.02
"""Impulse, over that of the weight in a frame, below which there is no contact."""


@dataclass(frozen=True)
class State:
    """States of a batch.

    Attributes:
        q: (B, nq) configurations.
        v: (B, nv) velocities.
    """

    q: Array
    v: Array

    def rows(self, index: Any) -> State:
        """Some of them."""
        return State(self.q[index], self.v[index])

    def minus(self, other: State) -> Array:
        """(B, 2 nv) differences: of poses in the other's tangent space, then of velocities."""
        return np.concatenate([difference(self.q, other.q), self.v - other.v], axis=-1)

    def plus(self, by: Array) -> State:
        """The states that differ by (B, 2 nv), the inverse of `minus`."""
        nv = self.v.shape[-1]
        return State(moved_pose(self.q, by[..., :nv]), self.v + by[..., nv:])

    def and_rows(self, other: State) -> State:
        """These, then others."""
        return State(np.concatenate([self.q, other.q]), np.concatenate([self.v, other.v]))

    def shifted(self, by: Array) -> State:
        """The same, moved by (3,) or (B, 3) [m]."""
        q = self.q.copy()
        q[..., :3] += by
        return State(q, self.v)

    def raised(self, by: Array) -> State:
        """The same, higher by (B,) [m]."""
        return self.shifted(by[..., None] * np.array([0.0, 0.0, 1.0]))


@dataclass(frozen=True)
class Contact:
    """Contact by which tossid's rigid one is replaced; the fields are those of an object and of `Law`.

    Where it yields, it acts on corners that are in the ground when a step begins, as engines have it (`Law.margin`).

    Attributes:
        compliance: [m/N].
        relaxation: [s].
        added_mass: [kg].
        lifting: [m].
        impulse_parts: Of an impact, where it does not yield.
        step_count: Steps a frame, which no impact cuts; None for those of tossid's own, where impacts end steps. Soft
            contact chatters in steps, and rigid one meets corners one after the other, so that their length matters.
    """

    compliance: float = 0.0
    relaxation: float = 0.0
    added_mass: float = 0.0
    lifting: float = 0.0
    impulse_parts: float = 1.0
    step_count: int | None = None

    def of(self, world: World) -> World:
        """A world with it.

        Args:
            world: Any.
        """
        yields = world.object.with_changes(compliance=self.compliance, relaxation=self.relaxation)
        margin = 0.0 if self.compliance > 0 else math.inf
        law = world.law._replace(
            added_mass=self.added_mass, lifting=self.lifting, impulse_parts=self.impulse_parts, margin=margin
        )
        return replace(world, object=yields, law=law)

    def steps(self, how: dict[str, Any]) -> dict[str, Any]:
        """Arguments of `simulate`.

        Args:
            how: The same for tossid's own steps.
        """
        return how if self.step_count is None else {**how, "substeps": self.step_count, "impact_parts": 1}


@dataclass(frozen=True)
class Touch:
    """How states touch the ground within a frame.

    Attributes:
        own: States a frame later in ours without effects, lowered.
        ratio: (B,) r; 1 where there is no contact.
        lowered: (B,) by how much ours is brought to touch [m].
        felt: (B,) whether there is contact.
    """

    own: State
    ratio: Array
    lowered: Array
    felt: NDArray[np.bool_]


@dataclass(frozen=True)
class StepChanges:
    """The changes of one frame that effects make, in the frame of the ground that they have.

    Attributes:
        with_effects: The world with effects.
        none: The same without.
        dt: Duration of a frame, in true time [s].
        how: Further arguments of `simulate`.
        contact: That is nearest to the user's simulator.
    """

    with_effects: World
    none: World
    dt: float
    how: dict[str, Any]
    contact: Contact = Contact()

    def __call__(self, at: State, theirs: State) -> Array:
        """(B, 2 nv) by how much theirs changes; NaN where ours diverges.

        Args:
            at: States at the beginning of the frame.
            theirs: Of the user's simulator at its end.
        """
        touch = self._touch(at, theirs)
        there, touches = at.raised(-touch.lowered), np.flatnonzero(touch.felt)
        if not len(touches) or self.with_effects.flies_like(self.none):
            return touch.ratio[:, None] * self._one(self.changed, there)[0].minus(touch.own)
        above = self._raised(at.rows(touches))
        both = self._one(self.changed, there.and_rows(above))[0]
        change = both.rows(slice(len(at.q))).minus(touch.own)
        free = both.rows(slice(len(at.q), None)).minus(self._one(self.plain, above)[0])
        change[touches] = free + touch.ratio[touches, None] * (change[touches] - free)
        return change

    def _touch(self, at: State, theirs: State) -> Touch:
        """How states touch the ground in a frame, at whose end their simulator has others."""
        weight = float(self.none.object.mass.sum()) * max(self.none.gravity, 1.0) * self.dt
        own, ours = self._one(self.plain, at)
        impulse = self._upward(theirs) - self._upward(own) + ours
        low = self._low(at.and_rows(theirs)).reshape(2, -1)
        here = (impulse > LEAST_IMPULSE * weight) & (low.min(axis=0) < NEAR_GROUND)
        lowered = np.zeros(len(ours))
        hover = np.flatnonzero(here & (ours < FEWEST_IMPULSE * impulse))
        if len(hover):
            lowered[hover] = np.maximum(low[0, hover], 0.0)
            lower, ours[hover] = self._one(self.plain, at.rows(hover).raised(-lowered[hover]))
            own.q[hover], own.v[hover] = lower.q, lower.v
        # where neither has contact, or only effects make it, the change is that of ours
        felt = here | (ours > LEAST_IMPULSE * weight)
        ratio = np.clip(impulse / np.maximum(ours, LEAST_IMPULSE * weight), 0.0, MOST_IMPULSE)
        return Touch(own, np.where(felt, ratio, 1.0), lowered, felt)

    def of_motions(self, first: State, steps: NDArray[np.int64], *, effects: bool) -> State:
        """Whole motions (B, T + 1, ...) of ours; NaN where one diverges.

        Args:
            first: First states.
            steps: (B,) frames after the first.
            effects: Whether with effects.
        """
        return self._run(self.changed if effects else self.plain, first, steps)[0]

    @cached_property
    def changed(self) -> System:
        """With effects."""
        return self._like_theirs(self.with_effects).system()

    @cached_property
    def plain(self) -> System:
        """Without."""
        return self._like_theirs(self.none).system()

    def _like_theirs(self, world: World) -> World:
        """A world with contact like theirs, but where effects are about how contact yields or bounces."""
        one, other = self.with_effects.object, self.none.object
        own = one.compliance == other.compliance and one.restitution == other.restitution
        return self.contact.of(world) if own else world

    def _one(self, system: System, at: State) -> tuple[State, Array]:
        """A frame later, and the vertical impulse of contact (B,) [N s]."""
        run, impulse = self._run(system, at, 1)
        return run.rows((slice(None), 1)), impulse

    def _run(self, system: System, first: State, steps: int | NDArray[np.int64]) -> tuple[State, Array]:
        """Motions of ours, and their vertical impulses (B,) [N s]."""
        return motions(system, first, steps, self.dt, self.contact.steps(self.how))

    def _raised(self, at: State) -> State:
        """States so high that nothing touches within a frame."""
        model = self.none.object
        arm = float(np.linalg.norm(model.corner_pos, axis=-1).max())
        speed = np.abs(at.v[:, 2]) + arm * np.abs(at.v[:, 3:]).sum(axis=-1) + 10.0 * self.dt
        return at.raised(np.maximum(0.0, 0.02 + 2.0 * self.dt * speed - self._low(at)))

    def _low(self, at: State) -> Array:
        """(B,) height of the stated object's lowest corner [m]."""
        return np.asarray(corner_heights(self.none.object, at.q).min(axis=-1))

    def _upward(self, at: State) -> Array:
        """(B,) vertical momentum [N s] of the stated object."""
        model = self.none.object
        if not model.n_joints:
            if not model.com.any():
                return np.asarray(model.mass[0] * at.v[:, 2])
            spin = quat_rotate(at.q[:, 3:7], np.cross(at.v[:, 3:6], model.com[0]))
            return np.asarray(model.mass[0] * (at.v[:, 2] + spin[:, 2]))
        _, u, _ = body_motions(model, at.q, at.v)
        return np.asarray(u[..., 2] @ model.mass)


def motions(
    system: System, first: State, steps: int | NDArray[np.int64], dt: float, how: dict[str, Any]
) -> tuple[State, Array]:
    """Motions (B, T + 1, ...) of tossid's own simulator, NaN where one diverges, and vertical impulses (B,) [N s].

    Args:
        system: The simulator.
        first: First states.
        steps: Frames.
        dt: Of a frame, in true time [s].
        how: Further arguments of `simulate`.
    """
    run = simulate(system, first.q, first.v, n_steps=steps, dt=dt, **how)
    run.q[~run.finite], run.v[~run.finite] = np.nan, np.nan
    return State(run.q, run.v), run.lam_n.sum(axis=(1, 2))
