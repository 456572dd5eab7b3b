"""Witnesses: what tosses say of some effects without a simulator, a window or a fit.

An impact on a lone corner between two flights gives an impulse J = m dv, where dv is the jump of the centre of mass's
velocity, at an arm r from there. Its moment makes the spin's jump dw, whatever the contact law is,

    r x (m dv) = I dw,

and the corner's own velocities before and after give restitution and, where it still slips, friction at an impact's
load. Of a body that slides on a face, local parabolas give friction at its weight's load, slow and fast. The centre of
mass and the errors of the recording are taken from a world: flight determines them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.findings import RESAMPLES, Interval
from tossid.diagnosis.parts import Part
from tossid.physics.body import rounded_corner_centres
from tossid.physics.effects import World
from tossid.rotations import quat_boxminus, quat_conj, quat_exp, quat_mul, quat_rotate, quat_to_matrix
from tossid.types import Toss

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]

FEWEST = 5
"""Tosses that a measurement needs."""
TOLERANCE = 0.05
"""Share of a value within which made tosses may differ from recorded ones by how finely they are simulated."""

FLIGHT = 6
"""Frames of flight before and after an impact, from which its velocities are taken."""
JUMP, QUIET = 0.2, 0.04
"""Change of velocity between frames that is an impact at least, and that is none at most, beyond noise [m/s]."""
LONGEST, LONGEST_ROUND = 2, 5
"""Frames in which the velocity jumps, of an impact of a corner, and of a round object, which may be soft."""
LONE = 0.1
"""Share of the object's width by which all other corners are higher than a lone one."""
ALONG_EDGE = 0.05
"""Sine of the angle to the spin below which an edge is hit as one place, at its middle."""
LEAST_CLOSING, LEAST_SLIP = 0.3, 0.3
"""Speed at which a corner hits at least, and at which it slips afterwards, for friction to be at its limit [m/s]."""
LEAST_SPIN_CHANGE = 5.0
"""Change of spin by an impact from which inertia is measured [rad/s]."""

PARABOLA = 11
"""Frames of a local parabola of sliding."""
FLAT, UNEVEN = 0.015, 0.3
"""Share of the object's width within which three corners of a face are as low, and of the median time step by which
another may differ."""
SLOW, FAST = (0.05, 0.1), (0.3, 0.6)
"""Slow and fast sliding [m/s]."""
MOST_SPIN = 0.5
"""Largest spin in sliding [rad/s]."""
DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True)
class Witness(Part):
    """A quantity that tosses reveal without a simulator.

    Attributes:
        quantity: In words.
        effect: Name of the effect of which it speaks.
        stated: Its value in the stated simulator.
        found: Its value with the effects that the diagnosis found.
        measured: Its value in the tosses.
        tosses: How many reveal it.
        predicted: Its value in tosses that the simulator with these effects makes, measured alike, so that what biases
            the measurement biases both. None where too few of them reveal it, or none were made.
        contradicts: Whether the tosses clearly have another value than those made tosses.
    """

    quantity: str
    effect: str
    stated: float
    found: float
    measured: Interval
    tosses: int
    predicted: Interval | None = None
    contradicts: bool = False


class Measurement(NamedTuple):
    """A quantity in m impacts or stretches of sliding.

    Attributes:
        says: What it is, in words.
        effect: Name of the effect of which it speaks.
        stated: Its value in the stated world.
        found: Its value in the found world.
        measured: (m,).
        toss: (m,) numbers of the tosses.
    """

    says: str
    effect: str
    stated: float
    found: float
    measured: Array
    toss: Index

    def interval(self) -> Interval | None:
        """The median over tosses of their medians, with its percentile interval over tosses; None of too few."""
        medians = _medians(self.measured, self.toss)
        if len(medians) < FEWEST:
            return None
        pick = np.random.default_rng(0).integers(0, len(medians), (RESAMPLES, len(medians)))
        return Interval.of(float(np.median(medians)), np.median(medians[pick], axis=1))


def _medians(measured: Array, toss: Index) -> Array:
    """(n,) median of each toss."""
    return np.array([np.median(measured[toss == i]) for i in np.unique(toss)])


def witnesses(tosses: Sequence[Toss], stated: World, found: World, made: Sequence[Toss] = ()) -> tuple[Witness, ...]:
    """What tosses, best others than those diagnosed, say of inertia, restitution and friction.

    Args:
        tosses: As recorded.
        stated: The world before the diagnosis.
        found: The world after it. Its recording errors, centre of mass and corners are used; its other values are only
            compared.
        made: Tosses that the found world makes. Those of equal name are draws of one toss.
    """
    predicted = {each.says: each.interval() for each in measurements(made, stated, found)}
    out = []
    for each in measurements(tosses, stated, found):
        value, theirs = each.interval(), predicted.get(each.says)
        if value is None:
            continue
        n, against = len(np.unique(each.toss)), False
        if theirs is not None:
            against = max(value.low - theirs.high, theirs.low - value.high) > TOLERANCE * abs(value.value)
        out.append(Witness(each.says, each.effect, each.stated, each.found, value, n, theirs, against))
    return tuple(out)


def measurements(tosses: Sequence[Toss], stated: World, found: World) -> list[Measurement]:
    """All quantities in impacts and slides.

    Args:
        tosses: As of `witnesses`.
        stated: As of `witnesses`.
        found: As of `witnesses`.

    Returns:
        None of an object with joints, whose impacts move its links in more complicated ways.
    """
    model, other = found.object, stated.object
    if model.n_joints or not tosses:
        return []
    is_round = model.roundness is not None
    part = "the lowest point" if is_round else "a lone corner"
    hit = lone_impacts(tosses, found)
    number = {name: i for i, name in enumerate(dict.fromkeys(toss.name for toss in tosses))}
    of_toss = np.array([number[toss.name] for toss in tosses], dtype=np.int64)

    turned = np.linalg.norm(hit.dw, axis=1) > LEAST_SPIN_CHANGE
    back = quat_to_matrix(hit.q).swapaxes(1, 2)
    impulse = (back @ np.cross(hit.arm, float(other.mass[0]) * hit.dv)[..., None])[..., 0]
    inertial = (back @ hit.dw[..., None])[..., 0] @ other.inertia[0].T
    ratio = ((impulse * inertial).sum(1) / np.maximum((inertial**2).sum(1), 1e-30))[turned]
    size = float(np.trace(model.inertia[0]) / model.mass[0] / (np.trace(other.inertia[0]) / other.mass[0]))
    of_hit = of_toss[hit.toss]
    bounced, rebounds = -hit.after[:, 2] / hit.before[:, 2], (_rebound(stated, hit), _rebound(found, hit))
    out = [
        Measurement("inertia over the stated", "inertia", 1.0, size, ratio, of_hit[turned]),
        Measurement(f"rebound of {part}", "restitution", *rebounds, bounced, of_hit),
    ]
    if is_round:
        # a round object sticks in most impacts, and has no face to slide on
        return out

    slips = np.linalg.norm(hit.after[:, :2], axis=1) > LEAST_SLIP
    slips &= (hit.before[:, :2] * hit.after[:, :2]).sum(axis=1) > 0  # what springs back has stuck
    ratio = (np.linalg.norm(hit.dv[:, :2], axis=1) / np.maximum(hit.dv[:, 2], 1e-9))[slips]
    frictions = other.friction, _mu(found, 1.0)
    out.append(Measurement("friction of a hit corner", "friction", *frictions, ratio, of_hit[slips]))
    number_of, speed, slowed = sliding(tosses, found).T
    load = found.gravity * float(model.mass[0])
    for name, (low, high) in (("slow", SLOW), ("fast", FAST)):
        inside = (speed >= low) & (speed < high)
        # each of the four corners of a face is held, and holds
        expected = _mu(found, 0.5 * (low + high)) * (1 + 4 * found.law.adhesion / load) + 4 * model.cohesion / load
        says, of_slide = f"friction of {name} sliding ({low:g} to {high:g} m/s)", of_toss[number_of[inside].astype(int)]
        out.append(Measurement(says, "friction", other.friction, expected, slowed[inside], of_slide))
    return out


@dataclass(frozen=True)
class Impacts:
    """n impacts on a lone corner, or on a round object's lowest point, between two flights, in the ground's axes.

    Attributes:
        toss: (n,) number of the toss.
        arm: (n, 3) place of contact minus centre of mass [m].
        dv: (n, 3) jump of the centre of mass's velocity [m/s].
        dw: (n, 3) jump of the spin [rad/s].
        before: (n, 3) velocity there before [m/s].
        after: (n, 3) velocity there after [m/s].
        q: (n, 4) attitudes, wxyz.
    """

    toss: Index
    arm: Array
    dv: Array
    dw: Array
    before: Array
    after: Array
    q: Array


def lone_impacts(tosses: Sequence[Toss], world: World) -> Impacts:
    """Impacts on a lone corner between two flights.

    Args:
        tosses: As recorded.
        world: Whose recording errors, centre of mass and corners are used.
    """
    gravity, n = world.gravity_on_ground(), FLIGHT
    most = LONGEST if world.object.roundness is None else LONGEST_ROUND
    numbers, rows = list[int](), list[Array]()
    for number, toss in enumerate(tosses):
        q, t, noise = _true(toss, world)
        place = q[:, :3] + quat_rotate(q[:, 3:], world.object.com[0])
        h = np.diff(t)
        velocities = np.diff(place, axis=0) / h[:, None]
        jumps = np.linalg.norm(np.diff(velocities, axis=0) - gravity * (0.5 * (t[2:] - t[:-2]))[:, None], axis=1)
        blur = noise * np.sqrt(h[1:] ** -2 + (1 / h[1:] + 1 / h[:-1]) ** 2 + h[:-1] ** -2)
        struck = np.flatnonzero(jumps > JUMP + 8 * blur) + 1
        for group in np.split(struck, np.flatnonzero(np.diff(struck) > 1) + 1):
            if not 0 < len(group) <= most or group[0] <= n or group[-1] + 1 + n >= len(q):
                continue
            last, first = int(group[0]) - 1, int(group[-1]) + 1
            beside = np.concatenate([np.arange(last - n, last - 1), np.arange(first, first + n - 1)])
            if (jumps[beside] > QUIET + 4 * blur[beside]).any():
                continue
            row = _impact(q, place, t, last, first, world)
            if row is not None:
                numbers.append(number)
                rows.append(row)
    values = np.array(rows).reshape(len(rows), 19)
    return Impacts(np.array(numbers, dtype=np.int64), *np.split(values, [3, 6, 9, 12, 15], axis=1))


def _impact(q: Array, place: Array, t: Array, last: int, first: int, world: World) -> Array | None:
    """(19,) arm, dv, dw, before, after and attitude of an impact between two frames; None of no lone corner.

    q: (n, 7) poses; place: (n, 3) of the centre of mass [m]; t: (n,) [s]; last: frame before the impact; first: after.
    """
    middle, gravity, lone = 0.5 * (t[last] + t[first]), world.gravity_on_ground(), LONE * world.object.width

    def flown(frames: Index) -> tuple[Array, Array, Array]:
        """Position, velocity and spin of a flight at the middle."""
        s, h = t[frames] - middle, np.diff(t[frames])[:, None]
        line = np.polynomial.polynomial.polyfit(s, place[frames] - 0.5 * np.outer(s**2, gravity), 1)
        turns = quat_rotate(q[frames[:-1], 3:], quat_boxminus(q[frames[1:], 3:], q[frames[:-1], 3:]) / h)
        return line[0], line[1], turns.mean(axis=0)

    p, v, w = flown(np.arange(last - FLIGHT, last + 1))
    p_after, v_after, w_after = flown(np.arange(first, first + FLIGHT + 1))
    jump = v_after - v
    # both parabolas pass through the impact
    when = float(jump @ (p - p_after) / (jump @ jump))
    if abs(when) > max(1.5 * float(np.diff(t[last : first + 1]).min()), 0.5 * (t[first] - t[last])):
        return None
    attitude = quat_mul(quat_exp(w * (middle - t[last] + when)), q[last, 3:])
    arms = _arms(world, attitude)
    if len(arms) > 2 and arms[1, 2] - arms[0, 2] < lone and _turns_about(arms[1] - arms[0], (w, w_after)):
        arms = np.concatenate([[0.5 * (arms[0] + arms[1])], arms[2:]])
    arm = arms[0]
    before = v + gravity * when + np.cross(w, arm)
    if (len(arms) > 1 and arms[1, 2] - arm[2] < lone) or before[2] > -LEAST_CLOSING:
        return None
    after = v_after + gravity * when + np.cross(w_after, arm)
    return np.concatenate([arm, jump, w_after - w, before, after, attitude])


def _arms(world: World, attitude: Array) -> Array:
    """(n_c, 3) from the centre of mass to where each corner would touch [m], in the ground's axes, lowest first."""
    model, radius = world.object, world.law.rounding
    if model.roundness is None:
        at = rounded_corner_centres(model.corner_pos, radius)
    else:
        at = model.corner_pos + model.roundness.offset(quat_rotate(quat_conj(attitude), DOWN)[None])
    arms = quat_rotate(attitude, at - model.com[0]) + radius * DOWN
    return np.asarray(arms[np.argsort(arms[:, 2])])


def _turns_about(edge: Array, spins: tuple[Array, Array]) -> bool:
    """Whether a body turns about an edge (3,) before and after an impact. So does one that moves in a plane."""
    return all(np.linalg.norm(np.cross(w, edge)) < ALONG_EDGE * np.linalg.norm(w) * np.linalg.norm(edge) for w in spins)


def sliding(tosses: Sequence[Toss], world: World) -> Array:
    """(n, 3) toss, speed [m/s], and deceleration over gravity, of stretches that slide on a face and hardly turn.

    Args:
        tosses: As recorded.
        world: Whose recording errors and corners are used.
    """
    corners, width, length = world.object.corner_pos, world.object.width, PARABOLA
    x = np.arange(length) - length // 2
    rows: list[tuple[int, float, float]] = []
    for number, toss in enumerate(tosses):
        q, t, noise = _true(toss, world)
        dt = float(np.median(np.diff(t)))
        fit = np.linalg.pinv(np.stack([np.ones(length), x * dt, 0.5 * (x * dt) ** 2], axis=1))
        heights = np.sort(q[:, 2:3] + quat_rotate(q[:, None, 3:], corners)[..., 2], axis=1)
        flat = heights[:, 2] - heights[:, 0] < FLAT * width
        for first in range(0, len(q) - length + 1, length // 2):
            part = slice(first, first + length)
            uneven = np.abs(np.diff(t[part]) / dt - 1).max() > UNEVEN
            if uneven or not flat[part].all() or np.ptp(q[part, 2]) > 4e-4 + 6 * noise:
                continue
            turn = quat_boxminus(q[part][-1, 3:], q[part][0, 3:]) / ((length - 1) * dt)
            _, v, a = fit @ q[part, :2]
            speed = float(np.linalg.norm(v))
            if speed > SLOW[0] and np.linalg.norm(turn) < MOST_SPIN:
                rows.append((number, speed, float(-(a @ v) / speed / world.gravity)))
    return np.array(rows).reshape(len(rows), 3)


def _true(toss: Toss, world: World) -> tuple[Array, Array, float]:
    """True poses (n, 7) in the ground's frame, their times (n,) [s], and the positions' noise [m]."""
    poses, cov = toss.measured
    q, _ = world.to_ground(poses, np.zeros((len(poses), 6)))
    noise = float(np.sqrt(np.maximum(np.einsum("nii->ni", cov)[:, :3].max(), 0.0)))
    return q, (toss.t - toss.t[0]) / world.recording.clock_rate, noise


def _rebound(world: World, hit: Impacts) -> float:
    """Speed after an impact over speed before it at a world's place of contact, whose mass is the impacts' median.

    A spring and a damper only push: Schwager and Poeschel, Granular Matter 9 (2007).
    """
    model = world.object
    if model.compliance == 0 or not len(hit.toss):
        return model.restitution
    lever = (quat_to_matrix(hit.q).swapaxes(1, 2) @ np.cross(hit.arm, DOWN)[..., None])[..., 0]
    yields = 1 / float(model.mass[0]) + np.einsum("ni,ij,nj->n", lever, np.linalg.inv(model.inertia[0]), lever)
    mass = 1 / float(np.median(yields)) + world.law.added_mass
    damping = 0.5 * model.relaxation / np.sqrt(model.compliance * mass)
    if damping >= 1:
        return 0.0
    root = np.sqrt(1 - damping**2)
    return float(np.exp(-damping / root * (np.pi - np.arctan2(2 * damping * root, 1 - 2 * damping**2))))


def _mu(world: World, speed: float) -> float:
    """Friction at a sliding speed [m/s]."""
    law = world.law
    return float(world.object.friction * (1 + (law.static_rel - 1) * np.exp(-((speed / law.slip_speed) ** 2))))
