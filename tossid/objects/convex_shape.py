"""A convex shape from nothing but poses over the ground: a polytope or, where it explains frames better, a round one.

Each frame bounds the object by a half-space, and a frame in contact touches it (`tossid.objects.half_spaces`). The
intersection of all half-spaces is an outer hull, from which the fits of `tossid.objects.polytope` and
`tossid.objects.round_shape` begin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from tossid.errors import InputError
from tossid.objects.half_spaces import HalfSpaces, evenly, half_spaces, protrusion
from tossid.objects.model import HULL_POINTS
from tossid.objects.polytope import (
    FIRST_GAP,
    GAP,
    Fit,
    bic_terms,
    find_polytope,
    fit_over_level_ground,
    fit_vertices,
    sloping_ground,
    touching,
)
from tossid.objects.round_shape import RoundShape, round_shapes, support
from tossid.objects.roundness import Roundness, directions, farthest
from tossid.robust import NORMAL_MAD
from tossid.types import PoseTrack, Toss

Array = NDArray[np.float64]

FEWEST_CONTACTS = 30
"""Different contacts below which there is no shape."""
UNSEEN = 0.15
"""Share of the radius of the largest ball inside the outer hull by which the hull may lie beyond the shape before it is
reported as unseen."""
_GAP_NOISES = 2.0
"""Scale of the loss in the last fit of a polytope, in standard deviations of the gaps' noise, where that is less."""
_ROUND_FRAMES = 1500
"""Frames, evenly drawn, from which round shapes are found."""
_SEEN_ANGLE = 0.15
"""Angle from the downward direction of a contact within which points of a round surface count as seen [rad]."""
_DIRECTIONS = np.random.default_rng(0).normal(size=(2000, 3))
_DIRECTIONS /= np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)


@dataclass(frozen=True)
class ConvexShape:
    """A convex shape that tosses have shown.

    Attributes:
        vertices: (n, 3) in the body's frame [m].
        deviation: (n,) standard error of each vertex in its least certain direction [m].
        frames: (n,) how many different contacts show each vertex.
        unseen: (m, 3) points of the outer hull that the object may reach and that no contact decides [m, body frame].
        ground: (3,) the ground as the shape needs it: its height at the origin [m] and its slopes along x and y. A
            height of a millimetre or two is also what rounded edges look like.
        misfit: Root mean square of the contacts' gaps [m].
        kind: "polytope", or what a round shape is called. `vertices` are then many points of its surface.
        corner_pos: (n_c, 3) corners of a round shape [m]; None for the vertices.
        roundness: What stands at the corners of a round shape.
    """

    vertices: Array
    deviation: Array
    frames: NDArray[np.int64]
    unseen: Array
    ground: Array
    misfit: float
    kind: str = "polytope"
    corner_pos: Array | None = None
    roundness: Roundness | None = None

    @property
    def corners(self) -> Array:
        """(n_c, 3) corners of contact [m]."""
        return self.vertices if self.corner_pos is None else self.corner_pos

    @property
    def mean_width(self) -> float:
        """Mean over all directions of the distance between the two planes that hold the shape [m]."""
        return float((self.reach(_DIRECTIONS) + self.reach(-_DIRECTIONS)).mean())

    def solid(self) -> tuple[float, Array, Array]:
        """Volume [m³], centre of mass [m] and inertia per mass about it [m²], if it were filled evenly.

        The moments are summed over the tetrahedra between a point inside and each triangle of the hull.
        """
        inside = self.vertices.mean(axis=0)
        corners = self.vertices[ConvexHull(self.vertices).simplices] - inside
        # of a tetrahedron from the origin to a, b, c: volume |det| / 6, mean s / 4, second moment (s sᵀ + Σ a aᵀ) / 20,
        # with s = a + b + c
        volume = np.abs(np.linalg.det(corners)) / 6
        total = corners.sum(axis=1)
        first = np.einsum("t,ti->i", volume, total) / 4
        second = np.einsum("t,ti,tj->ij", volume, total, total) + np.einsum("t,tvi,tvj->ij", volume, corners, corners)
        com = first / volume.sum()
        spread = second / 20 / volume.sum() - np.outer(com, com)
        return float(volume.sum()), inside + com, np.trace(spread) * np.eye(3) - spread

    def reach(self, down: Array) -> Array:
        """Support function h(d) = max_x d · x [m], (k,), for directions (k, 3)."""
        if self.corner_pos is not None and self.roundness is not None:
            return support(self.corner_pos, self.roundness, down)
        return np.asarray((down @ self.vertices.T).max(axis=1))


def find_shape(tosses: Sequence[Toss], *, flying: Sequence[NDArray[np.bool_]] | None = None) -> ConvexShape:
    """The convex shape of a rigid body, from its poses alone.

    Args:
        tosses: Of one rigid body, in any body frame, over the ground z = 0.
        flying: Frames of each toss that are known to be in free flight (`half_spaces`): they are no contacts.

    Returns:
        As few vertices as the contacts need. Vertices that no contact shows are not made up; `unseen` says where the
        object may reach further.

    Raises:
        InputError: The poses bound no shape, or there is no contact in them.
    """
    near, chosen, hull, radius = find_polytope(half_spaces(tosses, flying))
    sharp = fit_over_level_ground(near, chosen.vertices)
    rounder = _better_round_shape(near, sharp, hull)
    if rounder is not None:
        return _round_shape(near, rounder, hull, unseen=UNSEEN * radius)
    return sharp_shape(near, sharp, hull, unseen=UNSEEN * radius, ground=chosen.ground)


def ground_of_polytope(tosses: Sequence[Toss | PoseTrack], *, slack: float = 0.0) -> Array:
    """The ground's height at the origin [m] and its slopes along x and y, (3,), with which a polytope fits best.

    Args:
        tosses: Of one rigid body, z roughly up.
        slack: Slope that the ground may have.

    Raises:
        InputError: The poses bound no shape.
    """
    every = half_spaces(tosses)
    return sloping_ground(every, slack) if slack else find_polytope(every).fit.ground


def height_is_wrong(tosses: Sequence[Toss | PoseTrack]) -> bool:
    """Whether a polytope over a ground of another height explains frames better than any shape over z = 0 does.

    To a round shape, height and radius look alike: then z = 0 is taken.

    Args:
        tosses: Of one rigid body, over level ground.

    Raises:
        InputError: The poses bound no shape.
    """
    near, chosen, hull, _ = find_polytope(half_spaces(tosses))
    sharp = fit_vertices(near, chosen.vertices, np.zeros(3), gap=FIRST_GAP, level=True)
    scale, price = bic_terms(chosen.gap, near.free)
    lifted = chosen.loss / scale + (3 * len(chosen.vertices) + 1) * price
    level = sharp.loss / scale + 3 * len(sharp.vertices) * price
    return lifted < level and _better_round_shape(near, chosen, hull) is None


def sharp_shape(near: HalfSpaces, fit: Fit, hull: Array, *, unseen: float, ground: Array) -> ConvexShape:
    """The polytope of fitted vertices, with its certainty.

    Args:
        near: Frames near the ground.
        fit: Of vertices over the ground z = 0.
        hull: (m, 3) vertices of the outer hull [m].
        unseen: Distance from the polytope from which on they count as not decided [m].
        ground: (3,) the ground as the polytope needs it.

    Raises:
        InputError: There are too few contacts.
    """
    fit = _without_hovering(near, fit)
    touches = touching(fit.gap, near.free)
    if touches.sum() < FEWEST_CONTACTS:
        raise InputError(
            f"{int(touches.sum())} contacts with the ground in {len(np.unique(near.toss))} tosses; "
            f"a shape needs at least {FEWEST_CONTACTS}. Is the ground z = 0?"
        )
    misfit = float(np.sqrt(np.mean(fit.gap[touches] ** 2)))
    frames = np.bincount(fit.lowest[touches], minlength=len(fit.vertices))
    deviation = np.full(len(fit.vertices), np.inf)
    for i in np.flatnonzero(frames):
        down = near.down[touches & (fit.lowest == i)]
        least = np.linalg.eigvalsh(down.T @ down)[0]
        if least > 0:
            deviation[i] = misfit / np.sqrt(least)
    beyond = protrusion(hull, fit.vertices) > unseen
    return ConvexShape(fit.vertices, deviation, frames, hull[beyond], ground, misfit)


def _without_hovering(near: HalfSpaces, fit: Fit) -> Fit:
    """The fit with a loss above the ground that is as narrow as the noise.

    Frames that hover less than `GAP` above the ground would draw vertices outward; engines whose friction lifts what
    slides make many. Gaps below the ground are noise alone, and show its size.
    """
    below = -fit.gap[fit.gap < 0]
    if not len(below):
        return fit
    narrow = min(GAP, _GAP_NOISES * NORMAL_MAD * float(np.median(below)))
    return fit_vertices(near, fit.vertices, np.zeros(3), gap=GAP, level=True, last_gap=narrow)


def _better_round_shape(near: HalfSpaces, sharp: Fit, hull: Array) -> RoundShape | None:
    """The round shape that explains the frames better than the polytope does; None where none does."""
    which = evenly(len(near.height), _ROUND_FRAMES)
    drawn = near.chosen(which)
    thinned = len(near.height) / len(drawn.height)
    shapes = list(round_shapes(drawn, hull))
    # a shape that does not fit shows few contacts: noise and number are those of the one that shows the most
    gaps = [sharp.gap[which], *(shape.gap for shape in shapes)]
    scale, price = bic_terms(max(gaps, key=lambda gap: touching(gap, drawn.free).sum()), drawn.free)
    price += np.log(thinned)
    best, least = None, sharp.loss / scale + 3 * len(sharp.vertices) * price
    for shape in shapes:
        criterion = thinned * shape.loss / scale + shape.size * price
        if criterion < least:
            best, least = shape, criterion
    return best


def _round_shape(near: HalfSpaces, found: RoundShape, hull: Array, *, unseen: float) -> ConvexShape:
    """A round shape with many points of its surface, and which of them contacts show."""
    corners, ways = (found.corner_pos, found.roundness), directions(HULL_POINTS)
    gap = near.height - support(*corners, near.down)
    touches = touching(gap, near.free)
    misfit = float(np.sqrt(np.mean(gap[touches] ** 2)))
    slope, points = found.slope(ways), farthest(*corners, ways)
    surface = points[np.arange(len(ways)), np.einsum("ki,kci->kc", ways, points).argmax(axis=1)]
    beyond = (hull @ _DIRECTIONS.T - support(*corners, _DIRECTIONS)).max(axis=1) > unseen
    return ConvexShape(
        vertices=surface,
        deviation=misfit * np.sqrt(np.maximum(np.einsum("ki,ij,kj->k", slope, found.covariance, slope), 0)),
        frames=(ways @ near.down[touches].T > np.cos(_SEEN_ANGLE)).sum(axis=1),
        unseen=hull[beyond],
        ground=np.zeros(3),
        misfit=misfit,
        kind=found.kind,
        corner_pos=found.corner_pos,
        roundness=found.roundness,
    )
