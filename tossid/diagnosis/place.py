"""Where in the state and on the object the gap is: the residual wrench with the state that explains it, and shares of
the excess in contact by the corner that touches."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.findings import Corner, Gap, Interval, Place, Relation
from tossid.diagnosis.gap import RESAMPLES
from tossid.diagnosis.wrench import residual_wrench
from tossid.objects import ObjectModel, corner_positions
from tossid.physics.effects import World
from tossid.types import Phase, Toss

if TYPE_CHECKING:
    from tossid.diagnosis.judging import Candidate

Array = NDArray[np.float64]

TOUCHING = 2e-3
"""Height over the lowest corner [m] up to which another touches too: noise, and what a resting face is uneven by."""
CLEAR = 0.005
"""Share of resamples in which a corner that is clearly above the floor may be below."""


def located(
    tosses: Sequence[Toss], first: Candidate, present: Candidate, gap: Gap, left: Gap, *, seed: int = 0
) -> Place:
    """Where the gap of the stated simulator is, and what is left of it with the effects in.

    Args:
        first, present: the hypotheses without and with effects.
        gap, left: theirs.
        seed: of folds, signs and resamples.
    """
    world, dt = first.hypothesis.base, first.evidence.windows.dt

    def wrench(of: Candidate) -> tuple[Relation, ...]:
        return residual_wrench(of.evidence, of.hypothesis, of.fitted.residual, world.object, seed=seed)

    before = wrench(first)
    after = wrench(present) if present.hypothesis.effects else before
    corners, corners_left = (corner_shares(tosses, world, each, dt, whole=gap) for each in (gap, left))
    return Place(before, corners, after, corners_left)


def corner_shares(
    tosses: Sequence[Toss], world: World, gap: Gap, dt: float, *, whole: Gap | None = None
) -> tuple[Corner, ...]:
    """Each corner's share of the gap above the floor, over the frames in contact; flight is left out.

    A frame's excess goes to its lowest corner, in equal parts to those that are as low. A corner that has less than
    the floor has no share: floors are means over all of a phase, and where one corner is wrong they are too high for
    the others. None at all where no corner is clearly above it.

    Args:
        tosses: as measured.
        world: the stated simulator: its object's corners, over its ground.
        gap: of which the shares are.
        dt: between frames [s].
        whole: the gap that is 1; `gap` itself if None.
    """
    excess, touching = _by_toss(tosses, world, gap, dt)
    first = excess if whole is None else _by_toss(tosses, world, whole, dt)[0]
    n = len(tosses)
    pick = np.random.default_rng(0).integers(0, n, (RESAMPLES, n))
    drawn, of = (np.maximum(each[pick].sum(1), 0.0) for each in (excess, first))
    if not (np.quantile(of, CLEAR, axis=0) > 0).any():
        return ()
    every = np.maximum(first.sum(0), 0.0).sum()
    share = np.maximum(excess.sum(0), 0.0) / every
    low, high = np.percentile(drawn / np.maximum(of.sum(1, keepdims=True), 1e-9), [2.5, 97.5], axis=0)
    parts, frames = touching.sum(0).T
    return tuple(
        Corner(
            place=(float(x), float(y), float(z)),
            share=Interval(float(share[c]), float(low[c]), float(high[c])),
            frames=int(frames[c]),
            per_frame=float(share[c] * parts.sum() / parts[c]) if parts[c] > 0 else None,
            link=int(world.object.corner_body[c]),
        )
        for c, (x, y, z) in enumerate(corner_positions(world.object, _stretched(world.object)))
    )


def _stretched(model: ObjectModel) -> Array:
    """(nq,) the pose in which the base is the world's frame and joints are at zero."""
    q = np.zeros(model.nq)
    q[3] = 1.0
    return q


def _by_toss(tosses: Sequence[Toss], world: World, gap: Gap, dt: float) -> tuple[Array, Array]:
    """Sums of the excess (n, n_c); parts and numbers of frames (n, n_c, 2) that a corner touches in."""
    n_c = world.object.n_corners
    excess, touching = np.zeros((len(tosses), n_c)), np.zeros((len(tosses), n_c, 2))
    for i, toss in enumerate(tosses):
        rows = gap.frames[(gap.frames[:, 0] == i) & (gap.frames[:, 2] > Phase.FLIGHT)]
        if not len(rows):
            continue
        q = toss.measured[0][np.rint(rows[:, 1] / dt).astype(int)]
        height = corner_positions(world.object, world.to_ground(q, np.zeros((len(q), world.object.nv)))[0])[..., 2]
        low = height < height.min(1, keepdims=True) + TOUCHING
        part = low / low.sum(1, keepdims=True)
        excess[i] = rows[:, 3] @ part
        touching[i] = np.stack([part.sum(0), low.sum(0)], axis=1)
    return excess, touching
