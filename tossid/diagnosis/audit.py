"""The audit's cases, drawn with a seed.

A case has an effect of the library in it, two, none, a force that is no effect of the library, or an effect that is
then taken out of the library. Strengths are such that the object moves by a drawn multiple of the position noise:
the median over frames and tosses of the way between the same throw with and without the effect.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.objects import ObjectModel, corner_positions
from tossid.physics import simulate
from tossid.physics.effects import JOINT_EFFECTS, LIBRARY, Effect, World

Array = NDArray[np.float64]
Push = Callable[[float, Array, Array], Array]
"""From time [s], q (B, nq), v (B, nv) to the force (B, 3) [N], of which each link has its share by mass."""
Values = dict[str, float]
Kind = Literal["effect", "null", "pair", "outside", "without", "spoilt"]

KINDS: tuple[Kind, ...] = ("effect",) * 5 + ("null",) * 2 + ("pair", "outside", "without")
"""Every ten cases are these, in a drawn order."""
SUBSTEPS, IMPACT_PARTS = 32, 8
"""Steps a frame of engine lcp, and parts of one with an impact: far more than the diagnosis takes, whose errors the
truth must not share."""
TOGETHER = frozenset({"uniform_force", "world_tilt", "ground_tilt"})
"""Each is what the other two make: gravity of another direction, in a frame and on a ground that are tilted or not."""
MADE_OF = {
    "wind": frozenset({"linear_drag", "uniform_force"}),
    "time_base": frozenset({"gravity"}),
    "gravity": frozenset({"time_base"}),
}
"""What others say exactly: a drag against moving air is one against still air, and a constant force; a clock of another
rate is gravity of another size, for rigid contact has no time of its own."""
EFFECTS = (*LIBRARY, *JOINT_EFFECTS)
"""All that a case may have."""
REST = 0.01
"""Speed [m/s] below which the object rests."""
TRIES = 8


@dataclass(frozen=True)
class Case:
    """What a case is, but for the strengths, which `settled` finds. targets: ways over the position noise."""

    index: int
    kind: Kind
    engine: str
    effects: tuple[str, ...]
    targets: tuple[float, ...]
    seed: int

    @property
    def without(self) -> tuple[str, ...]:
        """What is taken out of the library: the effect, all that contain it, and what together would say the same."""
        if self.kind != "without":
            return ()
        true = frozenset(self.effects).union(*(MADE_OF.get(name, frozenset()) for name in self.effects))
        out = {e.name for e in EFFECTS if e.name in true or true & set(e.contains)}
        out |= TOGETHER if true & TOGETHER else set()
        return tuple(e.name for e in EFFECTS if e.name in out)

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return {**asdict(self), "effects": list(self.effects), "targets": list(self.targets)}


# ---------------------------------------------------------------- strengths


@dataclass(frozen=True)
class Strength:
    """Sizes that are tried, from the smallest to the largest, and the parameters of a size and of (8,) draws of -1..1.

    Draws turn the signs and directions, and set what has no size.
    """

    low: float
    high: float
    values: Callable[[float, Array], Values]


def _sign(u: Array) -> float:
    return 1.0 if u[0] > 0 else -1.0


def _signed(name: str, middle: float = 0.0) -> Callable[[float, Array], Values]:
    return lambda size, u: {name: middle + _sign(u) * size}


def _plain(name: str) -> Callable[[float, Array], Values]:
    return lambda size, u: {name: size}


def _scaled(name: str, middle: float = 1.0) -> Callable[[float, Array], Values]:
    return lambda size, u: {name: middle * math.exp(_sign(u) * size)}


def _directed(*names: str) -> Callable[[float, Array], Values]:
    n = len(names)
    return lambda size, u: dict(zip(names, (size / np.linalg.norm(u[:n]) * u[:n]).tolist(), strict=True))


def _between(low: float, high: float, u: float) -> float:
    """Log-uniform, of u in -1..1."""
    return low * (high / low) ** (0.5 * (1 + u))


def _wind(size: float, u: Array) -> Values:
    # no faster than throws are: a gale in thin air is a uniform force
    return {**_directed("x_ms", "y_ms")(_between(1, 4, u[2]), u), "c_nspm": size}


def _pull(size: float, u: Array) -> Values:
    # no farther than throws are: a weak pull from afar is a uniform force
    return {"k_npm": size, "x_m": 0.4 * float(u[0]), "y_m": 0.4 * float(u[1]), "z_m": 0.3 + 0.3 * float(u[2])}


def _velocity_friction(size: float, u: Array) -> Values:
    return {
        "static_mu": 0.18 * math.exp(size),
        "sliding_mu": 0.18 * math.exp(-0.5 * size),
        "speed_ms": _between(0.1, 0.6, u[1]),
    }


def _compliance(size: float, u: Array) -> Values:
    stiffness = 1 / size
    return {
        "stiffness_npm": stiffness,
        "damping_nspm": 2 * _between(0.1, 0.8, u[1]) * math.sqrt(stiffness * 0.37),
        "impedance_rel": max(0.0, 0.95 * float(u[2])),  # none in half of the cases
    }


STRENGTHS: dict[str, Strength] = {
    "com_offset": Strength(3e-4, 0.02, _directed("x_m", "y_m", "z_m")),
    "inertia": Strength(0.04, 1.0, _scaled("scale_rel")),
    "geometry": Strength(3e-3, 0.1, _scaled("size_rel")),
    "rounded_corners": Strength(1e-3, 0.02, _plain("radius_m")),
    "gravity": Strength(0.05, 4.0, _signed("g_ms2", 9.81)),
    "ground_tilt": Strength(2e-3, 0.1, _directed("x_rad", "y_rad")),
    "ground_height": Strength(5e-4, 0.03, _signed("z_m")),
    "linear_drag": Strength(5e-3, 0.6, _plain("c_nspm")),
    "quadratic_drag": Strength(5e-3, 0.6, _plain("c_ns2pm2")),
    "spin_drag": Strength(3e-5, 6e-3, _plain("c_nms")),
    "wind": Strength(5e-3, 0.4, _wind),
    "magnus": Strength(1e-3, 0.08, _signed("c_ns2pm")),
    "uniform_force": Strength(0.01, 2.0, _directed("x_n", "y_n", "z_n")),
    "position_force": Strength(0.05, 15.0, _pull),
    "vortex": Strength(0.1, 15.0, _signed("c_npm")),
    "turning_frame": Strength(0.03, 3.0, _signed("rate_ps")),
    "friction": Strength(0.05, 1.5, _scaled("mu", 0.18)),
    "velocity_friction": Strength(0.15, 1.5, _velocity_friction),
    "anisotropic_friction": Strength(
        0.1, 1.2, lambda s, u: {"x_mu": 0.18 * math.exp(_sign(u) * s), "y_mu": 0.18 * math.exp(-_sign(u) * s)}
    ),
    "cohesion": Strength(0.01, 1.5, _plain("c_n")),
    "torsional_friction": Strength(2e-3, 0.08, _plain("radius_m")),
    "rolling_resistance": Strength(5e-4, 0.05, _plain("radius_m")),
    "restitution": Strength(0.04, 0.7, _plain("e")),
    "compliance": Strength(1e-5, 1e-3, _compliance),
    "adhesion": Strength(0.02, 3.0, _plain("force_n")),
    "length_scale": Strength(2e-3, 0.2, _scaled("scale_rel")),
    "time_base": Strength(2e-3, 0.2, _scaled("rate_rel")),
    "body_frame_offset": Strength(7e-4, 0.03, _directed("x_m", "y_m", "z_m")),
    "world_tilt": Strength(2e-3, 0.1, _directed("x_rad", "y_rad")),
}

JOINT_STRENGTHS: dict[str, Strength] = {
    "joint_damping": Strength(5e-5, 0.02, _plain("c_nms")),
    "joint_friction": Strength(3e-4, 0.1, _plain("torque_nm")),
    "joint_stiffness": Strength(1e-3, 0.5, lambda s, u: {"k_nmprad": s, "rest_rad": 1.5 * float(u[0])}),
    "joint_offset": Strength(5e-3, 0.5, _signed("angle_rad")),
}
"""Of objects with joints."""

OUTSIDE: dict[str, Strength] = {
    "cubic_drag": Strength(5e-3, 0.8, _plain("c_ns3pm3")),
    "pulsing_force": Strength(
        0.03, 5.0, lambda s, u: {**_directed("x_n", "y_n")(s, u), "period_s": _between(0.08, 0.25, u[2])}
    ),
    "telegraph_force": Strength(
        0.03, 5.0, lambda s, u: {**_directed("x_n", "y_n")(s, u), "switches_ps": _between(8, 30, u[2])}
    ),
}
"""Forces that the library has not: -c |u|² u; to and fro, from a phase drawn a toss; changing sign at random."""

SPOILT: dict[str, Strength] = {
    "gravity": Strength(0.3, 1.5, _signed("g_ms2")),
    "com_offset": Strength(2e-3, 8e-3, _directed("x_m", "y_m", "z_m")),
    "inertia": Strength(0.25, 0.5, _scaled("scale_rel")),
    "friction": Strength(0.2, 0.6, _scaled("mu")),
    "geometry": Strength(0.05, 0.1, _scaled("size_rel")),
}
"""What a simulator's own parameters are spoiled by: gravity by so much, friction by a factor. Forty real tosses of the
cube tell inertia to 5 % and size to 2 % (docs/experiments/audit.md)."""


# ---------------------------------------------------------------- drawing


def draw_cases(
    n: int,
    *,
    seed: int,
    engines: Sequence[str],
    displacement: tuple[float, float],
    effects: Sequence[str] = tuple(STRENGTHS),
    only_lcp: Sequence[str] = (),
) -> tuple[Case, ...]:
    """The first n cases of a seed; those of a smaller n are the first of them.

    Args:
        effects: to draw from.
        engines: to take turns. displacement: least and largest target, over the position noise (log-uniform).
        only_lcp: effects that engine lcp alone has.
    """
    rng = np.random.default_rng([seed, 1])
    order = {kind: _endless(list(effects), rng) for kind in ("effect", "without")}
    pairs, outside = _endless(list(effects), rng), _endless(list(OUTSIDE), rng)
    kinds: list[Kind] = []
    cases = []
    turn = dict.fromkeys(KINDS, 0)
    for index in range(n):
        if not kinds:
            kinds = [KINDS[i] for i in rng.permutation(len(KINDS))]
        kind = kinds.pop()
        names: tuple[str, ...] = ()
        if kind in order:
            names = (next(order[kind]),)
        elif kind == "pair":
            names = _pair(pairs)
        elif kind == "outside":
            names = (next(outside),)
        engine = engines[turn[kind] % len(engines)]
        turn[kind] += 1
        if "lcp" in engines and (kind == "outside" or set(names) & set(only_lcp)):
            engine = "lcp"
        low, high = np.log(displacement)
        targets = tuple(float(x) for x in np.exp(rng.uniform(low, high, len(names))))
        cases.append(Case(index, kind, engine, names, targets, int(rng.integers(2**32))))
    return tuple(cases)


def draw_spoilt(n: int, *, seed: int) -> tuple[Case, ...]:
    """The first n cases of spoiled simulators."""
    rng = np.random.default_rng([seed, 2])
    names = _endless(list(SPOILT), rng)
    return tuple(Case(i, "spoilt", "real", (next(names),), (), int(rng.integers(2**32))) for i in range(n))


def _endless(names: list[str], rng: np.random.Generator) -> Iterator[str]:
    """All names in a drawn order, again and again. The order does not depend on when they are taken."""
    own = np.random.default_rng(rng.integers(2**32))
    while True:
        yield from (names[i] for i in own.permutation(len(names)))


def _pair(names: Iterator[str]) -> tuple[str, str]:
    """Two effects of different families, of which none contains the other."""
    first = next(names)
    while True:
        second = next(names)
        one, other = effect_named(first), effect_named(second)
        if one.family != other.family and second not in one.contains and first not in other.contains:
            return first, second


# ---------------------------------------------------------------- strengths that move the object so far


def effect_named(name: str) -> Effect:
    """The library's effect of that name."""
    return next(effect for effect in EFFECTS if effect.name == name)


def strengths_for(model: ObjectModel) -> dict[str, Strength]:
    """Of the effects that an object can have."""
    return STRENGTHS | (JOINT_STRENGTHS if model.n_joints else {})


def world_with(world: World, effects: Mapping[str, Values]) -> World:
    """The world with effects at values, their other parameters nominal."""
    for name, given in effects.items():
        effect = effect_named(name)
        values = effect.named(effect.nominal(world)) | dict(given)
        world = effect.at(world, np.array(list(values.values())))
    return world


def push_of(name: str, values: Values, *, count: int, seconds: float, seed: int) -> Push:
    """A force that the library has not, on `count` tosses of at most so many seconds."""
    rng = np.random.default_rng(seed)
    if name == "cubic_drag":
        return lambda t, q, v: -values["c_ns3pm3"] * (v[:, :3] ** 2).sum(1, keepdims=True) * v[:, :3]
    force = np.array([values["x_n"], values["y_n"], 0.0])
    if name == "pulsing_force":
        phase = rng.uniform(0, 2 * np.pi, count)
        return lambda t, q, v: np.sin(2 * np.pi * t / values["period_s"] + phase)[:, None] * force
    if name == "telegraph_force":
        step = 1e-3
        n = math.ceil(seconds / step) + 2
        flips = rng.uniform(size=(count, n)) < values["switches_ps"] * step
        signs = np.where((flips.cumsum(1) + rng.integers(0, 2, (count, 1))) % 2, 1.0, -1.0)
        return lambda t, q, v: signs[:, min(int(t / step), n - 1), None] * force
    raise InputError(f"there is no force '{name}' in the audit")


def motion(
    world: World, q0: Array, v0: Array, *, n_steps: int, dt: float, push: Push | None = None
) -> tuple[Array, Array]:
    """True motions in the ground's frame, (B, n_steps + 1, nq) and (…, nv), from true states there.

    A push acts in kicks at the ends of half frames, second order in time; it goes through the body's origin, where
    the stated object has its centre of mass.
    """
    system = world.system()
    if push is None:
        run = simulate(system, q0, v0, n_steps=n_steps, dt=dt, substeps=SUBSTEPS, impact_parts=IMPACT_PARTS)
        return run.q, run.v
    q, v = np.empty((len(q0), n_steps + 1, q0.shape[1])), np.empty((len(q0), n_steps + 1, v0.shape[1]))
    q[:, 0], v[:, 0] = q0, v0
    h, mass = 0.5 * dt, float(world.object.mass.sum())
    for frame in range(n_steps):
        q1, v1 = q[:, frame], v[:, frame]
        for half in range(2):
            t = frame * dt + half * h
            v1 = v1.copy()
            v1[:, :3] += 0.5 * h / mass * push(t, q1, v1)
            run = simulate(system, q1, v1, n_steps=1, dt=h, substeps=SUBSTEPS // 2, impact_parts=IMPACT_PARTS)
            q1, v1 = run.q[:, 1], run.v[:, 1].copy()
            v1[:, :3] += 0.5 * h / mass * push(t + h, q1, v1)
        q[:, frame + 1], v[:, frame + 1] = q1, v1
    return q, v


def way_between(one: Array, other: Array, dt: float, model: ObjectModel) -> float:
    """Median over tosses of the median over frames, until `one` rests, of the way between recorded positions [m].

    Of the object's origin, or, where there are joints, the mean of its corners'.

    one, other: (B, T, nq).
    """
    one, other = (corner_positions(model, q) if model.n_joints else q[..., None, :3] for q in (one, other))
    speed = np.linalg.norm(np.diff(one, axis=1), axis=-1).mean(-1) / dt
    ways = []
    for i in range(len(one)):
        moving = np.flatnonzero(speed[i] > REST)
        n = int(moving[-1]) + 2 if len(moving) else 2
        ways.append(float(np.median(np.linalg.norm(one[i, :n] - other[i, :n], axis=-1).mean(-1))))
    return float(np.median(ways))


def settled(
    name: str, target: float, world: World, q0: Array, v0: Array, *, noise: float, n_steps: int, dt: float, seed: int
) -> tuple[Values, float]:
    """Values of an effect (or of a force outside the library) that move the object by `target` times the noise.

    Args:
        q0, v0: (B, nq), (B, nv) true states that throws begin with. noise: [m].

    Returns:
        the values, and the multiple that they reach; it is another where the effect's range has no better.
    """
    strength = OUTSIDE[name] if name in OUTSIDE else strengths_for(world.object)[name]
    u = np.random.default_rng([seed, 3]).uniform(-1, 1, 8)
    plain = world.recorded_poses(motion(world, q0, v0, n_steps=n_steps, dt=dt)[0])
    low, high = math.log(strength.low), math.log(strength.high)
    at, best = 0.5 * (low + high), None
    for _ in range(TRIES):
        values = {key: float(x) for key, x in strength.values(math.exp(at), u).items()}
        if name not in OUTSIDE:
            there = world_with(world, {name: values})
            clocked = dt / there.recording.clock_rate
            moved = there.recorded_poses(motion(there, q0, v0, n_steps=n_steps, dt=clocked)[0])
        else:
            push = push_of(name, values, count=len(q0), seconds=n_steps * dt, seed=seed)
            moved = world.recorded_poses(motion(world, q0, v0, n_steps=n_steps, dt=dt, push=push)[0])
        ratio = way_between(plain, moved, dt, world.object) / noise
        off = math.log(max(ratio, 1e-3) / target)
        if best is None or abs(off) < best[0]:
            best = (abs(off), values, ratio)
        if abs(off) < 0.2:
            break
        low, high = (at, high) if off < 0 else (low, at)
        at = at - off if low < at - off < high else 0.5 * (low + high)
    assert best is not None
    return best[1], best[2]
