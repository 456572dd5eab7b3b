"""What a simulator's learned acceleration stands for: which effects of the library do in flight what it does.

A trained model carries in k_res whatever its training tosses showed beside the given dynamics. A diagnosis of such a
model finds no gap there, so it says what k_res does instead. At the diagnosed tosses' states in flight, what it does
is fitted by those of the library's forces, by least squares over the forces' parameters: the force with the least
Bayesian information criterion first, then others beside it. Tosses, not states, are the sample of that criterion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.parts import Part
from tossid.physics.effects import Effect, World
from tossid.physics.effects.wrenches import acceleration_of_motions, airborne, body_motions, learned_field
from tossid.types import Toss

Array = NDArray[np.float64]

MOST_STATES = 2000
"""States in flight at which the acceleration is compared with effects."""
MOST_EFFECTS = 3
"""That it is said to stand for."""
LEAST_SHARE = 0.05
"""Of its mean square, that an effect must do beyond those before it."""
LEAST_ACCELERATION = 0.05
"""Root mean square below which it does next to nothing [m/s²]; angular accelerations count over half a width."""

PLAIN = ("gravity", "forces", "registered", "law", "ground_height", "ground_tilt", "recording")
"""What a world has beside its object and its learned acceleration."""


@dataclass(frozen=True)
class StandsFor(Part):
    """An effect that a learned acceleration stands for.

    Attributes:
        name: The effect's.
        parameters: Its values, by name.
        share: Of the learned acceleration's mean square in flight, what it does beyond the effects before it.
    """

    name: str
    parameters: dict[str, float]
    share: float


@dataclass(frozen=True)
class LearnedForces(Part):
    """What a learned acceleration does in flight.

    Attributes:
        linear_ms2: Its root mean square at the centre of mass [m/s²].
        angular_rads2: The same of its angular part [rad/s²]; 0 for an object with joints, where it is not looked at.
        small: Whether that is next to nothing.
        stands_for: Effects that it stands for, the largest first.
        unexplained_share: Share of its mean square that these leave.
    """

    linear_ms2: float
    angular_rads2: float
    small: bool
    stands_for: tuple[StandsFor, ...] = ()
    unexplained_share: float = 1.0


def learned_forces(world: World, tosses: Sequence[Toss], library: Sequence[Effect]) -> LearnedForces | None:
    """What a world's learned acceleration stands for in the flights of tosses; None if there is none, or no flight.

    Args:
        world: The simulator.
        tosses: As recorded.
        library: Effects to choose from; those that are forces in flight are considered.
    """
    if world.k_res is None:
        return None
    q, v = world.to_ground(*(np.concatenate([getattr(toss, name) for toss in tosses]) for name in ("q", "v")))
    flying = np.flatnonzero(airborne(world.object, q))
    if not len(flying):
        return None
    chosen = flying[np.unique(np.linspace(0, len(flying) - 1, MOST_STATES).astype(int))]
    q, v = q[chosen], v[chosen]
    target = learned_field(world.object, world.k_res, q, v)
    linear, angular = (float(np.sqrt(np.square(x).sum(axis=1).mean())) for x in (target[:, :3], target[:, 3:]))
    weight = np.where(np.arange(target.shape[1]) < 3, 1.0, 0.5 * world.object.width)
    motions = body_motions(world.object, q, v)  # the same with every force
    given = acceleration_of_motions(world, q, motions)

    def errors(h: Hypothesis) -> Array:
        return np.asarray(weight * (acceleration_of_motions(h.world(), q, motions) - given - target))

    def left(h: Hypothesis) -> float:
        return float(np.square(errors(h)).sum(axis=1).mean())

    def criterion(h: Hypothesis) -> float:
        """Bayesian information criterion over the tosses."""
        n = len(tosses)
        return n * float(np.log(max(left(h), 1e-12))) + len(h.flat()) * float(np.log(n))

    best, shares = Hypothesis(world), list[float]()
    whole = left(best)
    if np.sqrt(whole) < LEAST_ACCELERATION:
        return LearnedForces(linear, angular, small=True)
    candidates = [effect for effect in library if _is_force(world, effect)]
    while len(best.effects) < MOST_EFFECTS:
        fits = [_with(best, effect, errors, left) for effect in candidates if effect.name not in best.names]
        found = min(fits, key=criterion, default=best)
        gained = (left(best) - left(found)) / whole
        if gained < LEAST_SHARE or criterion(found) >= criterion(best):
            break
        best = found
        shares.append(gained)
    named = (StandsFor(e.name, e.named(x), share) for (e, x), share in zip(best.items(), shares, strict=True))
    return LearnedForces(linear, angular, False, tuple(named), left(best) / whole)


def _is_force(world: World, effect: Effect) -> bool:
    """Whether an effect changes gravity or forces, and nothing else."""
    made = effect.at(world, effect.nominal(world) + [p.step for p in effect.parameters])
    same = [name for name in PLAIN if getattr(made, name) == getattr(world, name)]
    others = {name for name in PLAIN if name not in ("gravity", "forces", "registered")}
    return made.object is world.object and others <= {*same} and len(same) < len(PLAIN)


def _with(
    before: Hypothesis, effect: Effect, errors: Callable[[Hypothesis], Array], left: Callable[[Hypothesis], float]
) -> Hypothesis:
    """A hypothesis with one effect more, all fitted from the best of the effect's starts."""
    nominal = effect.nominal(before.base)
    step = np.array([p.step for p in effect.parameters])
    fits = []
    for start, sign in product([effect.named(nominal) | dict(s) for s in effect.starts or ({},)], (1.0, -1.0)):
        values = np.array([start[p.name] for p in effect.parameters])
        h = before.plus(effect, np.where(values == nominal, values + sign * step, values))
        (low, high), scale = h.bounds, h.steps
        x = np.clip(h.flat(), low + 1e-6 * scale, high - 1e-6 * scale)
        found = least_squares(lambda x, h=h: errors(h.at(x)).ravel(), x, bounds=(low, high), x_scale=scale)
        fits.append(h.at(found.x))
    return min(fits, key=left)
