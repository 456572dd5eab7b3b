"""How a cube leaves the ground when a face falls onto it about an edge: recorded, and as a simulator makes it.

    python -m pipelines.tools.experiments.by_hand.slaps FILE.h5 [--split train] [--parts 8]
                                                        [--effects '{"restitution": {"e": 0.3}}']

Two corners lie on the ground, the other two of a face fall. Parabolas through the frames before and after give the
vertical velocities of both edges' middles at the impact. The same is measured of tosses that tossid makes from the same
first states with the effects, with noise. A row a range of falling speeds: in how many impacts, by which share of it
the falling edge rebounds and the resting edge leaves, and how high the lowest corner is a few frames later. The effects
also say where the centre of mass is, and how the ground lies. `--parts` are an impact's (`Law.impulse_parts`).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipelines.tools.experiments.by_hand.given import arguments, asked
from tossid.physics.effects import World
from tossid.rotations import quat_boxminus, quat_exp, quat_mul, quat_rotate, quat_to_matrix
from tossid.types import Toss

Array = NDArray[np.float64]
SPEEDS = (0.25, 0.4, 0.55, 0.8, 2.0)
"""Ends of the ranges [m/s]."""
NEAR, FAR = 0.004, 0.01
"""Height up to which a corner lies on the ground, and from which on it falls, four frames before the impact [m]."""
FRAMES = 5
"""Of a parabola."""
AFTER = slice(2, 7)
"""Frames after the impact in which the lowest corner is looked at."""
NOISE = (1e-4, 9e-4)
"""Of made poses [m, rad]: that of the real cube's single frames."""


def slaps(poses: Sequence[Array], world: World, dt: float) -> Array:
    """(n, 4) impacts: falling speed [m/s], rebound and leaving speed over it, and height of the lowest corner [m].

    Args:
        poses: (T, 7) true poses in the ground's frame, one array a toss.
        world: Whose centre of mass and corners these are.
        dt: Between frames [s].
    """
    com, corners = world.object.com[0], world.object.corner_pos
    rows = []
    for q in poses:
        turned = quat_to_matrix(q[:, 3:])
        heights = q[:, 2:3] + turned[:, 2] @ corners.T
        low, centre = np.sort(heights, axis=1), q[:, 2] + (turned[:, 2] @ com)
        spins = quat_rotate(q[:-1, 3:], quat_boxminus(q[1:, 3:], q[:-1, 3:]) / dt)
        for k in range(FRAMES + 2, len(q) - FRAMES - 2):
            falls = low[k, 2] < NEAR <= low[k - 1, 2] and low[k - 4, 2] > FAR
            if not (falls and max(low[k - 4, 1], low[k - 1, 1]) < NEAR):
                continue
            resting = np.argsort(heights[k - 3])[:2]
            falling = [c for c in np.argsort(heights[k + 1])[:4] if c not in resting]
            if len(falling) != 2:
                continue
            before, after = np.arange(k - FRAMES, k), np.arange(k + 1, k + 1 + FRAMES)
            rise = [
                np.polynomial.Polynomial.fit((part - k) * dt, centre[part], 2).deriv()(0) for part in (before, after)
            ]
            spin = spins[k - 4 : k - 1].mean(axis=0), spins[k + 1 : k + 5].mean(axis=0)
            arms = [turned[k] @ (corners[some].mean(axis=0) - com) for some in (resting, falling)]
            (_, rest_after), (fall, rebound) = (
                [up + np.cross(turn, arm)[2] for up, turn in zip(rise, spin, strict=True)] for arm in arms
            )
            if fall < -SPEEDS[0]:
                rows.append((-fall, -rebound / fall, -rest_after / fall, heights[k:][AFTER].min(axis=1).max()))
    return np.array(rows).reshape(len(rows), 4)


def made(tosses: Sequence[Toss], world: World, dt: float, seed: int = 0) -> list[Array]:
    """True poses of tosses that a world makes from the first states of recorded ones, with noise.

    Args:
        tosses: As recorded.
        world: The simulator.
        dt: Between frames [s].
        seed: Of the noise.
    """
    rng, frames = np.random.default_rng(seed), max(len(toss.t) for toss in tosses)
    first = (np.stack([toss.q[0] for toss in tosses]), np.stack([toss.v[0] for toss in tosses]))
    run = world.roll_out(*first, n_steps=frames - 1, dt=dt, substeps=8, impact_parts=8)
    run[..., :3] += NOISE[0] * rng.normal(size=run[..., :3].shape)
    run[..., 3:] = quat_mul(run[..., 3:], quat_exp(NOISE[1] * rng.normal(size=run[..., :3].shape)))
    return [_in_ground(q[: len(toss.t)], world) for q, toss in zip(run, tosses, strict=True)]


def _in_ground(q: Array, world: World) -> Array:
    return world.to_ground(q, np.zeros((len(q), 6)))[0]


def table(recorded: Array, simulated: Array) -> str:
    """Both beside each other, in Markdown.

    Args:
        recorded: As of `slaps`.
        simulated: The same of made tosses.
    """
    heads = ("falls at [m/s]", "impacts", "rebounds", "other edge leaves", "lowest corner after [mm]")
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for low, high in itertools.pairwise(SPEEDS):
        parts = [rows[(rows[:, 0] > low) & (rows[:, 0] <= high)] for rows in (recorded, simulated)]
        if min(map(len, parts)) == 0:
            continue
        middle = [np.median(part, axis=0) for part in parts]
        cells = [f"{low:g} to {high:g}", f"{len(parts[0])}, {len(parts[1])} made"]
        cells += [f"{middle[0][j]:.2f}, {middle[1][j]:.2f} made" for j in (1, 2)]
        cells.append(f"{1e3 * middle[0][3]:.1f}, {1e3 * middle[1][3]:.1f} made")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Print the table."""
    parser = arguments(__doc__)
    parser.add_argument("--parts", type=float, default=8.0)
    given = parser.parse_args()
    dataset, tosses, world = asked(given)
    world, dt = replace(world, law=world.law._replace(impulse_parts=given.parts)), 1 / dataset.rate_hz
    recorded = slaps([_in_ground(toss.measured[0], world) for toss in tosses], world, dt)
    print(table(recorded, slaps(made(tosses, world, dt), world, dt)))  # noqa: T201


if __name__ == "__main__":
    main()
