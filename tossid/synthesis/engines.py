"""The engines that carry a toss on from its release. A new one is a class of settings with a `name`, and an entry."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.errors import DivergedError
from tossid.physics import ExactCone, PolyhedralCone
from tossid.physics import simulate as simulate_lcp
from tossid.physics.effects import World
from tossid.physics.effects.in_mujoco import inexpressible, toss_in_mujoco
from tossid.settings.synthesis import BulletEngine, DrakeEngine, LcpEngine, MujocoEngine
from tossid.synthesis.foreign_engines import lacks_in_bullet, lacks_in_drake, toss_in

Array = NDArray[np.float64]


class Motions(NamedTuple):
    """What an engine makes of n releases, true and in the ground's frame.

    Attributes:
        q: (n, T, nq) configurations, the first of them the releases.
        v: (n, T, nv) velocities.
        unsolved: In how many time steps the contact problem missed its tolerance.
    """

    q: Array
    v: Array
    unsolved: int


@dataclass(frozen=True)
class EngineEntry:
    """An engine as `ENGINES` lists it.

    Attributes:
        settings: The class of its settings; its instances have the engine's `name`.
        simulate: `(settings, world, q0, v0, n_steps=..., dt=...)` to `Motions`; dt is true time [s].
        lacks: Gives the names of what a world has and the engine has not.
    """

    settings: type
    simulate: Callable[..., Motions]
    lacks: Callable[[World], tuple[str, ...]]


def _lcp(engine: LcpEngine, world: World, q0: Array, v0: Array, *, n_steps: int, dt: float) -> Motions:
    done = simulate_lcp(
        world.system(),
        q0,
        v0,
        n_steps=n_steps,
        dt=dt,
        substeps=engine.substeps,
        impact_parts=engine.impact_parts,
        solver=PolyhedralCone(engine.directions) if engine.directions else ExactCone(),
        n_threads=os.cpu_count() or 1,
    )
    if not done.finite.all():
        lost = int(np.argmin(done.finite))
        raise DivergedError(f"toss {lost} of engine lcp became non-finite", state=(q0[lost], v0[lost]))
    return Motions(done.q, done.v, int(done.unsolved.sum()))


def _mujoco(engine: MujocoEngine, world: World, q0: Array, v0: Array, *, n_steps: int, dt: float) -> Motions:
    threads = os.cpu_count() or 1
    how: dict[str, Any] = {"substeps": engine.substeps, "soft": engine.soft, "n_threads": threads}
    return Motions(*toss_in_mujoco(world, q0, v0, n_steps, dt, **how), unsolved=0)


def _foreign(
    engine: DrakeEngine | BulletEngine, world: World, q0: Array, v0: Array, *, n_steps: int, dt: float
) -> Motions:
    return Motions(*toss_in(engine, world, q0, v0, n_steps=n_steps, dt=dt), unsolved=0)


ENGINES: dict[str, EngineEntry] = {
    "lcp": EngineEntry(LcpEngine, _lcp, lambda world: ()),
    "mujoco": EngineEntry(MujocoEngine, _mujoco, inexpressible),
    "drake": EngineEntry(DrakeEngine, _foreign, lacks_in_drake),
    "bullet": EngineEntry(BulletEngine, _foreign, lacks_in_bullet),
}
"""The engines by name."""


def able(world: World) -> Mapping[str, EngineEntry]:
    """The engines that have all that a world has."""
    return {name: entry for name, entry in ENGINES.items() if not entry.lacks(world)}
