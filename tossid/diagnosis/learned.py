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
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

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


@dataclass(frozen=True)
class StandsFor:
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
class LearnedForces:
    """What a learned acceleration does in flight.

    Attributes:
        linear: Its root mean square at the centre of mass [m/s²].
        angular: The same of its angular part [rad/s²]; 0 for an object with joints, where it is not looked at.
        small: Whether that is next to nothing.
        effects: Those that it stands for, the largest first.
        unexplained: Share of its mean square that these leave.
    """

    linear: float
    angular: float
    small: bool
    effects: tuple[StandsFor, ...] = ()
    unexplained: float = 1.0

    def as_json(self) -> dict[str, Any]:
        """gap.json's "learned_acceleration"."""
        return {
            "linear_ms2": self.linear,
            "angular_rads2": self.angular,
            "small": self.small,
            "stands_for": [{"name": e.name, "parameters": e.parameters, "share": e.share} for e in self.effects],
            "unexplained_share": self.unexplained,
        }


@dataclass(frozen=True)
class _Fit:
    """Effects, their values, and the mean square that they leave."""

    effects: tuple[Effect, ...]
    values: Array
    left: float


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
    whole = float(np.square(weight * target).sum(axis=1).mean())
    if np.sqrt(whole) < LEAST_ACCELERATION:
        return LearnedForces(linear, angular, small=True)
    motions = body_motions(world.object, q, v)  # the same with every force
    given = acceleration_of_motions(world, q, motions)

    def errors(effects: Sequence[Effect], values: Array) -> Array:
        changed = acceleration_of_motions(_with(world, effects, values), q, motions) - given
        return np.asarray(weight * (changed - target))

    candidates = [effect for effect in library if _is_force(world, effect)]
    best, n, shares = _Fit((), np.zeros(0), whole), len(tosses), list[float]()
    while len(best.effects) < MOST_EFFECTS:
        fits = [_fitted(world, best, e, errors) for e in candidates if all(e is not other for other in best.effects)]
        if not fits:
            break
        found = min(fits, key=lambda fit: _criterion(fit, n))
        gained = (best.left - found.left) / whole
        if gained < LEAST_SHARE or _criterion(found, n) >= _criterion(best, n):
            break
        best = found
        shares.append(gained)
    parts = _parts(best)
    named = tuple(
        StandsFor(effect.name, effect.named(part), share)
        for effect, part, share in zip(best.effects, parts, shares, strict=True)
    )
    return LearnedForces(linear, angular, False, named, best.left / whole)


def _is_force(world: World, effect: Effect) -> bool:
    """Whether an effect changes gravity or forces, and nothing else."""
    start = effect.nominal(world)
    made = effect.at(world, start + [p.step for p in effect.parameters])
    same = made.with_changes(
        gravity=world.gravity, forces=world.forces, registered=world.registered, object=world.object
    )
    return made.object is world.object and _unchanged(same, world) and not _unchanged(made, world)


def _unchanged(one: World, other: World) -> bool:
    return all(getattr(one, name) == getattr(other, name) for name in _PLAIN)


_PLAIN = ("gravity", "forces", "law", "ground_height", "ground_tilt", "recording", "registered")


def _parts(fit: _Fit) -> list[Array]:
    """Each effect's values."""
    ends = np.cumsum([len(effect.parameters) for effect in fit.effects])
    return np.split(fit.values, ends[:-1]) if len(ends) else []


def _with(world: World, effects: Sequence[Effect], values: Array) -> World:
    for effect, part in zip(effects, _parts(_Fit(tuple(effects), values, 0.0)), strict=True):
        world = effect.at(world, part)
    return world


def _fitted(world: World, before: _Fit, effect: Effect, errors: Callable[[Sequence[Effect], Array], Array]) -> _Fit:
    """The fit with one effect more, from each of the effect's starts."""
    effects = (*before.effects, effect)
    every = [p for each in effects for p in each.parameters]
    low, high = np.array([p.low for p in every]), np.array([p.high for p in every])
    scale = np.array([p.step for p in every])
    nominal = effect.nominal(world)
    best = None
    for start, sign in product([effect.named(nominal) | dict(s) for s in effect.starts or ({},)], (1.0, -1.0)):
        values = np.array([start[p.name] for p in effect.parameters])
        moved = np.where(values == nominal, values + sign * np.array([p.step for p in effect.parameters]), values)
        x = np.clip(np.concatenate([before.values, moved]), low + 1e-6 * scale, high - 1e-6 * scale)
        found = least_squares(lambda x: errors(effects, x).ravel(), x, bounds=(low, high), x_scale=scale)
        left = float(np.square(errors(effects, found.x)).sum(axis=1).mean())
        if best is None or left < best.left:
            best = _Fit(effects, found.x, left)
    assert best is not None
    return best


def _criterion(fit: _Fit, n: int) -> float:
    """Bayesian information criterion over n tosses."""
    return n * float(np.log(max(fit.left, 1e-12))) + len(fit.values) * float(np.log(n))
