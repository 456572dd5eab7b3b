"""Where on the object the gap is: shares of the excess in contact by the corner that touches."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.findings import Corner, Gap, Interval, Place, Relation
from tossid.diagnosis.localisation.wrench import residual_wrench
from tossid.objects import ObjectModel, corner_heights, corner_positions
from tossid.physics.effects import World
from tossid.settings.diagnosis.diagnose import DiagnoseSettings, LocalisationSettings
from tossid.types import Phase, Toss

if TYPE_CHECKING:
    from tossid.diagnosis.selection.cross_validation import Candidate

Array = NDArray[np.float64]


def locate(
    tosses: Sequence[Toss],
    first: Candidate,
    present: Candidate,
    gap: Gap,
    left: Gap,
    *,
    seed: int = 0,
    settings: DiagnoseSettings = DiagnoseSettings(),
) -> Place:
    """Where the gap of the stated simulator is, and what is left of it with the effects in.

    Args:
        tosses: As recorded.
        first: The hypothesis without effects.
        present: The hypothesis with effects.
        gap: Of the first.
        left: Of the second.
        seed: Of folds, signs and resamples.
        settings: Of the diagnosis.
    """
    world, dt = first.hypothesis.base, first.evidence.windows.dt

    def wrench(of: Candidate) -> tuple[Relation, ...]:
        residuals = of.fitted.residuals
        return residual_wrench(of.evidence, of.hypothesis, residuals, world.object, seed=seed, settings=settings.wrench)

    before = wrench(first)
    after = wrench(present) if present.hypothesis.effects else before
    corners, corners_left = (
        corner_shares(tosses, world, each, dt, whole=gap, settings=settings.localisation) for each in (gap, left)
    )
    return Place(before, corners, after, corners_left)


def corner_shares(
    tosses: Sequence[Toss],
    world: World,
    gap: Gap,
    dt: float,
    *,
    whole: Gap | None = None,
    settings: LocalisationSettings = LocalisationSettings(),
) -> tuple[Corner, ...]:
    """Each corner's share of the gap above the noise floor in the frames with contact; flight is left out.

    A frame's excess goes to its lowest corner, in equal parts to those that are as low. A corner below the floor has no
    share: floors are means over a whole phase, and where one corner is wrong they are too high for the others. No
    shares at all where no corner is clearly above the floor.

    Args:
        tosses: As recorded.
        world: The stated simulator, whose object has the corners.
        gap: What is shared out.
        dt: Between frames [s].
        whole: The gap of which the shares are; `gap` itself if None.
        settings: When a corner touches, and when it is clear.
    """
    excess, touching = _by_toss(tosses, world, gap, dt, settings.corner_height)
    first = excess if whole is None else _by_toss(tosses, world, whole, dt, settings.corner_height)[0]
    n = len(tosses)
    pick = np.random.default_rng(0).integers(0, n, (settings.resamples, n))
    drawn, of = (np.maximum(each[pick].sum(1), 0.0) for each in (excess, first))
    if not (np.quantile(of, settings.corner_level, axis=0) > 0).any():
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
        for c, (x, y, z) in enumerate(corner_positions(world.object, _zero_pose(world.object)))
    )


def _zero_pose(model: ObjectModel) -> Array:
    """(nq,) the pose in which the base is the world's frame and joints are at zero."""
    q = np.zeros(model.nq)
    q[3] = 1.0
    return q


def _by_toss(tosses: Sequence[Toss], world: World, gap: Gap, dt: float, touching_height: float) -> tuple[Array, Array]:
    """Each toss's excess by corner (n, n_c), and parts and numbers of frames (n, n_c, 2) in which a corner touches."""
    n_c = world.object.n_corners
    excess, touching = np.zeros((len(tosses), n_c)), np.zeros((len(tosses), n_c, 2))
    for i, toss in enumerate(tosses):
        rows = gap.frames[(gap.frames[:, 0] == i) & (gap.frames[:, 2] > Phase.FLIGHT)]
        if not len(rows):
            continue
        q = toss.measured[0][np.searchsorted(toss.ticks(dt), np.rint(rows[:, 1] / dt))]
        height = corner_heights(world.object, world.to_ground(q, np.zeros((len(q), world.object.nv)))[0])
        low = height < height.min(1, keepdims=True) + touching_height
        part = low / low.sum(1, keepdims=True)
        excess[i] = rows[:, 3] @ part
        touching[i] = np.stack([part.sum(0), low.sum(0)], axis=1)
    return excess, touching
