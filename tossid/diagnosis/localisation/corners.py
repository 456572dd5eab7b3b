"""Where the gap is: on the object by the corner that touches, and in the state of the motion by residual wrenches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.findings import RESAMPLES, Interval
from tossid.diagnosis.inference.evidence import Evidence
from tossid.diagnosis.localisation.gap import Rows, rows_of
from tossid.diagnosis.localisation.noise import noise_floor
from tossid.diagnosis.localisation.place import Corner, Place
from tossid.diagnosis.localisation.wrench import residual_wrench
from tossid.objects import corner_heights, corner_positions
from tossid.physics.effects import World
from tossid.types import Phase, Toss

Array = NDArray[np.float64]

TOUCHING = 2e-3
"""Height over the lowest corner up to which another touches too [m]: noise, and unevenness of a resting face."""
LEVEL = 0.005
"""Share of resamples in which a corner that is clearly above the noise floor may be below it."""


def place_of(tosses: Sequence[Toss], before: Evidence, after: Evidence | None, *, seed: int) -> Place:
    """Where the gap of the stated simulator is, and what is left of it with the effects in.

    Args:
        tosses: n, as recorded. The evidences number them from 0 to n - 1.
        before: Of the stated simulator.
        after: Of the hypothesis with effects at the values that all tosses determine; None if nothing was found.
        seed: Of signs and resamples.
    """
    floor, world, dt = noise_floor(before.windows), before.hypothesis.base, before.windows.dt
    evidences = [before] if after is None else [before, after]
    rows = [rows_of([(each, np.arange(len(tosses)))], floor) for each in evidences]
    corners = [corner_shares(tosses, world, each, dt, whole=rows[0]) for each in rows]
    wrench = [residual_wrench(each, seed=seed) for each in evidences]
    return Place(wrench[0], corners[0], wrench[-1], corners[-1])


def corner_shares(tosses: Sequence[Toss], world: World, rows: Rows, dt: float, *, whole: Rows) -> tuple[Corner, ...]:
    """Each corner's share of the gap above the noise floor in the frames with contact; flight is left out.

    A frame's excess goes to its lowest corner, in equal parts to those that are as low. A corner below the floor has no
    share: floors are means over a whole phase, and where one corner is wrong they are too high for the others.

    Args:
        tosses: As recorded.
        world: The stated simulator, whose object has the corners.
        rows: What is shared out.
        dt: Between frames [s].
        whole: The gap of which the shares are.

    Returns:
        None where no corner is clearly above the floor.
    """
    (excess, touching), (first, _) = (_by_toss(tosses, world, each, dt) for each in (rows, whole))
    n = len(tosses)
    counts = np.random.default_rng(0).multinomial(n, np.full(n, 1 / n), RESAMPLES).astype(float)
    drawn, of = (np.maximum(counts @ each, 0.0) for each in (excess, first))
    if not (np.quantile(of, LEVEL, axis=0) > 0).any():
        return ()
    share = np.maximum(excess.sum(0), 0.0) / np.maximum(first.sum(0), 0.0).sum()
    shares = drawn / np.maximum(of.sum(1, keepdims=True), 1e-9)
    parts, frames = touching.sum(0).T
    zero = np.eye(world.object.nq)[3]  # the base at the origin, not turned, and joints at zero
    return tuple(
        Corner(
            place=(float(x), float(y), float(z)),
            share=Interval.of(share[c], shares[:, c]),
            frames=int(frames[c]),
            per_frame=float(share[c] * parts.sum() / parts[c]) if parts[c] > 0 else None,
            link=int(world.object.corner_body[c]),
        )
        for c, (x, y, z) in enumerate(corner_positions(world.object, zero))
    )


def _by_toss(tosses: Sequence[Toss], world: World, rows: Rows, dt: float) -> tuple[Array, Array]:
    """Each toss's excess by corner (n, n_c), and parts and numbers of frames (n, n_c, 2) in which a corner touches."""
    n_c, mean = world.object.n_corners, rows.excess.mean(1)
    excess, touching = np.zeros((len(tosses), n_c)), np.zeros((len(tosses), n_c, 2))
    for i, toss in enumerate(tosses):
        of = np.flatnonzero((rows.toss == i) & (rows.phase > Phase.FLIGHT))
        if not len(of):
            continue
        q = toss.measured[0][np.searchsorted(toss.ticks(dt), np.rint(rows.time[of] / dt))]
        height = corner_heights(world.object, world.to_ground(q, np.zeros((len(q), world.object.nv)))[0])
        low = height < height.min(1, keepdims=True) + TOUCHING
        part = low / low.sum(1, keepdims=True)
        excess[i] = mean[of] @ part
        touching[i] = np.stack([part.sum(0), low.sum(0)], axis=1)
    return excess, touching
