"""The contact of tossid's own that is nearest to a user's simulator, and whether that goes on from any state.

Changes of a frame by effects (`step_changes`) are those of the stated object in tossid's simulator. They are the better
the more its contact is like that of the simulator that is judged. Motions of the latter from the tosses' first states
show what one frame does to states near the ground. Candidates are rigid contact, contact that yields (a spring, a
damper and an added mass, as MuJoCo has it), each of them as the convex relaxation of Coulomb's law, and rigid contact
whose impacts are resolved in parts. The velocities after a frame decide. They also show how many steps a frame the
simulator takes, where contact yields: what slides over soft ground leaves it and comes back within a few steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from tossid.diagnosis.likelihood.engine_discrepancy import IMPULSE_PARTS
from tossid.diagnosis.likelihood.step_changes import Contact, State, motions
from tossid.objects import corner_heights
from tossid.physics.effects import World
from tossid.physics.mujoco_engine import LIFTING

Array = NDArray[np.float64]

MOST_MOTIONS, MOST_STATES = 16, 300
"""Motions, and states of them near the ground, that are looked at."""
BEGINNINGS = ((2e3, 40.0, 0.9), (2e4, 60.0, 0.1))
"""Stiffness [N/m] and damping [N s/m] of a corner and its impedance, from which contact that yields is fitted."""
MOST_EVALUATIONS = 80
"""Of each such fit (Nelder and Mead)."""
MOST_STEPS, FIRST_STEPS = 16, 4
"""Of a frame, and those with which contact that yields is fitted first."""
SHORT = 0.5
"""Share of the error of rigid contact below which contact that yields is taken. MuJoCo's leaves a seventh. Bullet's 0.8
and Drake's 0.7 are a damper's that stands in for the order of impacts, and predict effects no better than rigid ones.
"""


@dataclass(frozen=True)
class Frames:
    """What a user's simulator does in one frame to states near the ground.

    Attributes:
        before: States.
        after: A frame later.
        lost: Share of the changes of velocity, over all frames of whole motions, that one frame from the states on the
            way does not repeat.
    """

    before: State
    after: State
    lost: float


def frames_of(
    motion: Callable[[Array, Array, NDArray[np.int64], float], State],
    onward: Callable[[State, float], State],
    first: State,
    steps: NDArray[np.int64],
    dt: float,
    world: World,
) -> Frames:
    """Frames of a user's simulator.

    Args:
        motion: Whole motions of it, from first states.
        onward: States of it a frame later.
        first: States at which tosses begin.
        steps: (B,) frames of each.
        dt: Of a frame, in true time [s].
        world: The stated object.
    """
    first, steps = first.rows(slice(MOST_MOTIONS)), steps[:MOST_MOTIONS]
    whole = motion(first.q, first.v, steps, dt)
    frames = np.flatnonzero((np.arange(whole.q.shape[1] - 1) < steps[:, None]).ravel())

    def flat(some: slice) -> State:
        return State(*(x[:, some].reshape(-1, x.shape[-1])[frames] for x in (whole.q, whole.v)))

    before, then = flat(slice(-1)), flat(slice(1, None))
    after = onward(before, dt)
    fall = np.zeros(before.v.shape[1])
    fall[2] = -world.gravity * dt
    arm = 0.5 * world.object.width
    scale = np.array([1.0] * 3 + [arm] * (before.v.shape[1] - 3))
    moves = np.concatenate([scale / dt, scale])
    lost = np.abs(moves * after.minus(then)).sum() / np.abs(scale * (then.v - before.v - fall)).sum()
    low = corner_heights(world.object, before.q).min(axis=1)
    near = np.flatnonzero(low < 1e-2 + dt * np.abs(before.v[:, 2]))
    near = near[:: max(1, len(near) // MOST_STATES)]
    return Frames(before.rows(near), after.rows(near), float(lost))


def nearest_contact(frames: Frames, world: World, dt: float, **how: Any) -> Contact:
    """The contact with which the stated object's velocities after a frame are nearest to theirs.

    Args:
        frames: Of the user's simulator.
        world: The stated object.
        dt: Of a frame, in true time [s].
        **how: Further arguments of `simulate`.
    """
    scale = np.array([1.0] * 3 + [0.5 * world.object.width] * (frames.before.v.shape[1] - 3))

    def error(contact: Contact) -> float:
        run, _ = motions(contact.of(world).system(), frames.before, 1, dt, contact.steps(how))
        # square roots: a frame in which the order of impacts differs is no reason to yield
        return float(np.sqrt(np.abs(scale * np.nan_to_num(run.v[:, 1] - frames.after.v, nan=1e3))).mean())

    def in_steps(contact: Contact) -> list[Contact]:
        return [replace(contact, step_count=1 + n) for n in range(MOST_STEPS)]

    rigid = [Contact(lifting=lifting) for lifting in (0.0, LIFTING)]
    best = min([*rigid, Contact(impulse_parts=IMPULSE_PARTS)], key=error)
    best = min([best, *in_steps(best)], key=error)
    first = [replace(each, step_count=FIRST_STEPS) for each in rigid]
    soft = [_fitted(begin, each, error, world) for each in first for begin in BEGINNINGS]
    softest, begin = min(soft, key=lambda found: error(found[0]))
    softest, _ = _fitted(begin, min(in_steps(softest), key=error), error, world)
    return softest if error(softest) < SHORT * error(best) else best


def _fitted(
    begin: Sequence[float], like: Contact, error: Callable[[Contact], float], world: World
) -> tuple[Contact, tuple[float, ...]]:
    """Contact that yields, fitted from given stiffness, damping and impedance, and what these are then."""
    mass = float(world.object.mass.sum())

    def numbers(x: Array) -> tuple[float, ...]:
        stiffness, damping = np.exp(np.clip(x[:2], 0.0, 13.0))
        return float(stiffness), float(damping), float(1.0 / (1.0 + np.exp(-np.clip(x[2], -5.0, 5.0))))

    def contact(x: Array) -> Contact:
        stiffness, damping, impedance = numbers(x)
        return replace(
            like,
            compliance=(1 - impedance) / stiffness,
            relaxation=damping / stiffness,
            added_mass=mass * impedance / (1 - impedance),
        )

    start = np.array([np.log(begin[0]), np.log(begin[1]), np.log(begin[2] / (1 - begin[2]))])
    found = minimize(
        lambda x: error(contact(x)), start, method="Nelder-Mead",
        options={"maxfev": MOST_EVALUATIONS, "xatol": 0.02, "fatol": 1e-5},
    )  # fmt: skip
    return contact(found.x), numbers(found.x)
