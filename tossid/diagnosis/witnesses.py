"""Witnesses: what tosses show of some effects without any simulator, window or fit.

A lone corner that is hit between two flights gives an impulse J = m dv, where dv is the jump of the centre of mass's
velocity, at an arm r from there. Its moment makes the spin's jump dw, whatever the law of contact is,

    r x (m dv) = I dw,

and the corner's own velocities before and after give restitution and, where it still slips, friction at an impact's
load. Of a body that slides on a face, local parabolas give friction at its weight's load, slow and fast. Where the
centre of mass is and how lengths are recorded is taken from the diagnosis: flight tells these.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap

from tossid.diagnosis.findings import Interval, Witness
from tossid.physics.effects import World
from tossid.physics.single import inset
from tossid.rotations import quat_boxminus, quat_exp, quat_mul, quat_rotate, quat_to_matrix
from tossid.types import Toss

Array = NDArray[np.float64]

FLIGHT = 6
"""Frames of flight before and after an impact, that give its velocities."""
JUMP, QUIET = 0.2, 0.04
"""Change of velocity between frames [m/s] that is an impact at least, and no impact at most; beside noise."""
LONE = 0.1
"""Share of the object's width by which all other corners are higher."""
CLOSING = 0.3
"""[m/s] at which a corner hits at least."""
SLIPPING = 0.3
"""[m/s] at which a corner slips after an impact at least, for its friction to be all there is."""
PARABOLA = 11
"""Frames of a local parabola."""
LEVEL = 0.015
"""Share of the object's width within which three corners are as low, on a face."""
SLOW, FAST = (0.05, 0.1), (0.3, 0.6)
"""[m/s] of sliding."""
LEAST_SPIN = 5.0
"""[rad/s] that an impact changes the spin by, for inertia to show."""
MOST_SPIN = 0.5
"""[rad/s] about the vertical, of sliding."""
FEWEST = 5
"""Tosses that make a witness."""


@dataclass(frozen=True)
class Impacts:
    """n impacts on a lone corner between two flights, in the ground's axes.

    toss (n,). arm (n, 3): corner from the centre of mass [m]. dv (n, 3): jump of the centre of mass's velocity [m/s];
    dw (n, 3): of the spin [rad/s]. before, after (n, 3): velocities of the corner [m/s]. q (n, 4): attitudes.
    """

    toss: NDArray[np.int64]
    arm: Array
    dv: Array
    dw: Array
    before: Array
    after: Array
    q: Array


def witnesses(tosses: Sequence[Toss], stated: World, found: World) -> tuple[Witness, ...]:
    """What tosses, best others than those diagnosed, say of inertia, restitution and friction.

    Args:
        stated: the world before, found: the world after the diagnosis; the latter's recording, centre of mass and
            corners are used, and nothing else of it but to be compared.

    Returns:
        none of an object with joints: what its impacts do to its links is not told so simply.
    """
    if found.object.n_joints:
        return ()
    hit, slides = lone_impacts(tosses, found), sliding(tosses, found)
    model, other = found.object, stated.object
    out: list[Witness | None] = []

    turned = np.linalg.norm(hit.dw, axis=1) > LEAST_SPIN
    back = quat_to_matrix(hit.q).swapaxes(1, 2)
    impulse = (back @ np.cross(hit.arm, float(other.mass[0]) * hit.dv)[..., None])[..., 0]
    inertial = (back @ hit.dw[..., None])[..., 0] @ other.inertia[0].T
    ratio = (impulse * inertial).sum(1) / np.maximum((inertial**2).sum(1), 1e-30)
    size = float(np.trace(model.inertia[0]) / model.mass[0] / (np.trace(other.inertia[0]) / other.mass[0]))
    out.append(_witness("inertia over the stated", "inertia", 1.0, size, ratio, hit.toss, turned))

    bounced = -hit.after[:, 2] / hit.before[:, 2]
    everywhere = np.ones(len(bounced), bool)
    bounce = ("restitution", other.restitution, model.restitution)
    out.append(_witness("rebound of a lone corner", *bounce, bounced, hit.toss, everywhere))

    load = found.gravity * float(model.mass[0])
    slips = np.linalg.norm(hit.after[:, :2], axis=1) > SLIPPING
    grip = np.linalg.norm(hit.dv[:, :2], axis=1) / np.maximum(hit.dv[:, 2], 1e-9)
    out.append(
        _witness("friction of a hit corner", "friction", stated.object.friction, _mu(found, 1.0), grip, hit.toss, slips)
    )
    for name, (low, high) in (("slow", SLOW), ("fast", FAST)):
        inside = (slides[:, 1] >= low) & (slides[:, 1] < high)
        middle = 0.5 * (low + high)
        says = f"friction of {name} sliding ({low:g} to {high:g} m/s)"
        alike = _mu(found, middle) + 4 * model.cohesion / load
        out.append(
            _witness(says, "friction", stated.object.friction, alike, slides[:, 2], slides[:, 0].astype(int), inside)
        )
    return tuple(each for each in out if each is not None)


def lone_impacts(tosses: Sequence[Toss], world: World) -> Impacts:
    """Impacts on a lone corner between two flights, of tosses as a world records them."""
    gravity, radius = world.gravity_on_ground(), world.law.rounding
    corners, com = inset(world.object.corner_pos, radius), world.object.com[0]
    rows: list[tuple[int, Array]] = []
    for number, toss in enumerate(tosses):
        q, dt, noise = _true(toss, world)
        place = q[:, :3] + quat_rotate(q[:, 3:], com)
        jumps = np.linalg.norm(np.diff(np.diff(place, axis=0) / dt, axis=0) - gravity * dt, axis=1)
        blur = np.sqrt(6.0) * noise / dt
        struck = np.flatnonzero(jumps > JUMP + 8 * blur) + 1
        for group in np.split(struck, np.flatnonzero(np.diff(struck) > 1) + 1):
            if not 0 < len(group) <= 2:
                continue
            last, first = int(group[0]) - 1, int(group[-1]) + 1
            if last < FLIGHT or first + FLIGHT >= len(q):
                continue
            beside = np.concatenate([jumps[last - FLIGHT : last - 1], jumps[first : first + FLIGHT - 1]])
            if beside.max() > QUIET + 4 * blur:
                continue
            row = _impact(q, place, last, first, dt, gravity, corners - com, radius, LONE * world.object.width)
            if row is not None:
                rows.append((number, row))
    values = np.array([row for _, row in rows]).reshape(len(rows), 19)
    parts = np.split(values, [3, 6, 9, 12, 15], axis=1)
    return Impacts(np.array([number for number, _ in rows], dtype=int), *parts)


def _impact(
    q: Array, place: Array, last: int, first: int, dt: float, gravity: Array, corners: Array, radius: float, lone: float
) -> Array | None:
    """(19,) arm, dv, dw, before, after, attitude of an impact between two frames; None if it is of no lone corner."""
    middle = 0.5 * (last + first)

    def flown(frames: NDArray[np.integer]) -> tuple[Array, Array, Array]:
        t = (frames - middle) * dt
        line = np.polynomial.polynomial.polyfit(t, place[frames] - 0.5 * np.outer(t**2, gravity), 1)
        turns = quat_rotate(q[frames[:-1], 3:], quat_boxminus(q[frames[1:], 3:], q[frames[:-1], 3:]) / dt)
        return line[0], line[1], turns.mean(axis=0)

    p, v, w = flown(np.arange(last - FLIGHT, last + 1))
    p_after, v_after, w_after = flown(np.arange(first, first + FLIGHT + 1))
    jump = v_after - v
    when = float(jump @ (p - p_after) / (jump @ jump))
    if abs(when) > 1.5 * dt:
        return None
    attitude = quat_mul(quat_exp(w * ((middle - last) * dt + when)), q[last, 3:])
    arms = quat_rotate(attitude, corners)
    order = np.argsort(arms[:, 2])
    arm = arms[order[0]] - [0.0, 0.0, radius]
    before = v + gravity * when + np.cross(w, arm)
    if arms[order[1], 2] - arms[order[0], 2] < lone or before[2] > -CLOSING:
        return None
    return np.concatenate([arm, jump, w_after - w, before, v_after + gravity * when + np.cross(w_after, arm), attitude])


def sliding(tosses: Sequence[Toss], world: World) -> Array:
    """(n, 3) toss, speed [m/s], and deceleration over gravity, of stretches that slide on a face and hardly turn."""
    corners, width = world.object.corner_pos, world.object.width
    x = np.arange(PARABOLA) - PARABOLA // 2
    rows: list[tuple[int, float, float]] = []
    for number, toss in enumerate(tosses):
        q, dt, noise = _true(toss, world)
        fit = np.linalg.pinv(np.stack([np.ones(PARABOLA), x * dt, 0.5 * (x * dt) ** 2], axis=1))
        heights = np.sort(q[:, 2:3] + quat_rotate(q[:, None, 3:], corners)[..., 2], axis=1)
        flat = heights[:, 2] - heights[:, 0] < LEVEL * width
        for first in range(0, len(q) - PARABOLA + 1, PARABOLA // 2):
            part = slice(first, first + PARABOLA)
            if not flat[part].all() or np.ptp(q[part, 2]) > 4e-4 + 6 * noise:
                continue
            turn = quat_boxminus(q[part][-1, 3:], q[part][0, 3:]) / ((PARABOLA - 1) * dt)
            _, v, a = fit @ q[part, :2]
            speed = float(np.linalg.norm(v))
            if speed > SLOW[0] and np.linalg.norm(turn) < MOST_SPIN:
                rows.append((number, speed, float(-(a @ v) / speed / world.gravity)))
    return np.array(rows).reshape(len(rows), 3)


def _true(toss: Toss, world: World) -> tuple[Array, float, float]:
    """True poses (n, 7) in the ground's frame, time between frames [s], and the positions' noise [m]."""
    poses, cov = toss.measured
    q, _ = world.to_ground(poses, np.zeros((len(poses), 6)))
    noise = float(np.sqrt(np.maximum(np.einsum("nii->ni", cov)[:, :3].max(), 0.0)))
    return q, float(np.median(np.diff(toss.t))) / world.recording.clock_rate, noise


def _mu(world: World, speed: float) -> float:
    law = world.law
    return float(world.object.friction * (1 + (law.static_rel - 1) * np.exp(-((speed / law.slip_speed) ** 2))))


def _witness(
    says: str,
    effect: str,
    stated: float,
    found: float,
    values: Array,
    toss: NDArray[np.int64],
    chosen: NDArray[np.bool_],
) -> Witness | None:
    """The median over tosses of their medians, with its percentile interval (bootstrap over tosses)."""
    whose = np.unique(toss[chosen])
    if len(whose) < FEWEST:
        return None
    medians = np.array([np.median(values[chosen & (toss == i)]) for i in whose])
    ends = bootstrap(
        (medians,), np.median, confidence_level=0.95, method="percentile", rng=np.random.default_rng(0)
    ).confidence_interval
    value = Interval(float(np.median(medians)), float(ends.low), float(ends.high))
    return Witness(says, effect, stated, found, value, len(whose))
