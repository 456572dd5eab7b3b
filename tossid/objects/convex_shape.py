"""A convex shape from nothing but poses over the ground.

No point x of an object is ever below the ground: p_z + e_z · R x ≥ 0 in every frame, with the body's origin p and its
rotation R. With the downward direction in the body's frame, d = -Rᵀ e_z, this reads d · x ≤ p_z: each frame bounds the
object by a half-space, and a frame in contact touches it. So the support function h(d) = max_x d · x of the object is
at most p_z, and equals it in contact. The intersection of all half-spaces is an outer hull. Its vertices, hundreds of
them for noise, are merged into the few that a max-affine regression of h needs (Magnani and Boyd, "Convex
piecewise-linear fitting", 2009): each frame is assigned to the vertex that is lowest in it, and vertices are fitted to
their frames. A frame that is not in contact has a gap, which a redescending loss leaves out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial import ConvexHull

from tossid.errors import InputError
from tossid.objects.half_spaces import HalfSpaces, different, evenly, half_spaces, outer_hull, protrusion
from tossid.objects.max_affine import Fit, fit_vertices, ground_slope, loss_of, weights_of
from tossid.objects.model import HULL_POINTS
from tossid.objects.round_shape import RoundShape, round_shapes, support, surface
from tossid.objects.roundness import Roundness, directions
from tossid.settings.objects import ShapeSettings
from tossid.types import PoseTrack, Toss

Array = NDArray[np.float64]

DEFAULT = ShapeSettings()


@dataclass(frozen=True)
class ConvexShape:
    """A convex polytope that tosses have shown.

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


def find_shape(
    tosses: Sequence[Toss],
    settings: ShapeSettings = DEFAULT,
    *,
    flying: Sequence[NDArray[np.bool_]] | None = None,
) -> ConvexShape:
    """The convex shape of a rigid body, from its poses alone.

    Args:
        tosses: Of one rigid body, in any body frame, over the ground z = 0.
        settings: What counts as contact, and which vertices count.
        flying: Frames of each toss that are known to be in free flight (`half_spaces`): they are no contacts.

    Returns:
        As few vertices as the contacts need. Vertices that no contact shows are not made up; `unseen` says where the
        object may reach further.

    Raises:
        InputError: The poses bound no shape, or there is no contact in them.
    """
    seen, chosen, corners, radius = polytope(half_spaces(tosses, flying), settings)
    sharp = fit_vertices(seen, chosen.vertices, np.zeros(3), settings, gap=2 * settings.gap, level=True)
    rounder = _rounder(seen, sharp, corners, settings)
    if rounder is not None:
        return _round_shape(seen, rounder, corners, unseen=settings.unseen_rel * radius, settings=settings)
    return sharp_shape(
        seen, sharp, corners, unseen=settings.unseen_rel * radius, ground=chosen.ground, settings=settings
    )


def sharp_shape(
    seen: HalfSpaces, fit: Fit, hull: Array, *, unseen: float, ground: Array, settings: ShapeSettings
) -> ConvexShape:
    """The polytope of fitted vertices, with its certainty.

    Args:
        seen: Frames near the ground.
        fit: Of vertices over the ground z = 0.
        hull: (m, 3) vertices of the outer hull [m].
        unseen: Distance from the polytope from which on they count as not decided [m].
        ground: (3,) the ground as the polytope needs it.
        settings: As of `find_shape`.

    Raises:
        InputError: There are too few contacts.
    """
    fit = _without_hovering(seen, fit, settings)
    touches = (np.abs(fit.gap) < settings.contact_gap) & ~seen.free
    if touches.sum() < settings.fewest_contacts:
        raise InputError(
            f"{int(touches.sum())} contacts with the ground in {len(np.unique(seen.toss))} tosses; "
            f"a shape needs at least {settings.fewest_contacts}. Is the ground z = 0?"
        )
    misfit = float(np.sqrt(np.mean(fit.gap[touches] ** 2)))
    deviation, frames = _certainty(seen, fit, touches, misfit)
    beyond = np.array([protrusion(corner, fit.vertices) for corner in hull])
    return ConvexShape(fit.vertices, deviation, frames, hull[beyond > unseen], ground, misfit)


def find_ground(tosses: Sequence[Toss | PoseTrack], settings: ShapeSettings = DEFAULT, *, slack: float = 0.0) -> Array:
    """The ground's height at the origin [m] and its slopes along x and y, (3,), with which a polytope fits best.

    Args:
        tosses: Of one rigid body, z roughly up.
        settings: As of `find_shape`.
        slack: Slope that the ground may have: each half-space is first moved out by it times the distance from the
            middle of all places.

    Raises:
        InputError: The poses bound no shape.
    """
    every = half_spaces(tosses)
    if not slack:
        return polytope(every, settings)[1].ground
    far = slack * np.linalg.norm(every.place - np.median(every.place, axis=0), axis=1)
    _, radius, corners = outer_hull(every._replace(height=every.height + far), settings)
    seen = every.chosen(different(every, settings))
    seen = seen.chosen(seen.height - (seen.down @ corners.T).max(axis=1) < settings.near_rel * radius)
    drawn = seen.chosen(evenly(len(seen.height), settings.most_frames))
    start = merged(corners, settings.merge_rel * radius)
    return fit_vertices(drawn, start, np.zeros(3), settings, gap=float(np.quantile(far, 0.9))).ground


def height_is_wrong(tosses: Sequence[Toss | PoseTrack], settings: ShapeSettings = DEFAULT) -> bool:
    """Whether a polytope over a ground of another height explains frames better than any shape over z = 0 does.

    To a round shape, height and radius look alike: then z = 0 is taken.

    Args:
        tosses: Of one rigid body, over level ground.
        settings: As of `find_shape`.

    Raises:
        InputError: The poses bound no shape.
    """
    seen, chosen, corners, _ = polytope(half_spaces(tosses), settings)
    sharp = fit_vertices(seen, chosen.vertices, np.zeros(3), settings, gap=settings.first_gap, level=True)
    scale, price = price_of(chosen.gap, seen.free, settings)
    lifted = chosen.loss / scale + (3 * len(chosen.vertices) + 1) * price
    level = sharp.loss / scale + 3 * len(sharp.vertices) * price
    return lifted < level and _rounder(seen, chosen, corners, settings) is None


def polytope(every: HalfSpaces, settings: ShapeSettings) -> tuple[HalfSpaces, Fit, Array, float]:
    """Frames near the ground, the polytope and the ground that fit them, the outer hull's vertices and its radius.

    Args:
        every: All frames.
        settings: As of `find_shape`.

    Raises:
        InputError: The poses bound no shape.
    """
    _, radius, corners = outer_hull(every, settings)
    seen = every.chosen(different(every, settings))
    seen = seen.chosen(seen.height - (seen.down @ corners.T).max(axis=1) < settings.near_rel * radius)
    drawn = seen.chosen(evenly(len(seen.height), settings.most_frames))
    start = merged(corners, settings.merge_rel * radius)
    fits = [fit_vertices(drawn, start, np.zeros(3), settings, gap=settings.first_gap)]
    while len(fits[-1].vertices) > 4:
        fits.append(_with_fewer(drawn, fits[-1], settings))
    chosen = _without_flat(drawn, _fewest(drawn, fits, settings), settings)
    return seen, fit_vertices(seen, chosen.vertices, chosen.ground, settings, gap=2 * settings.gap), corners, radius


# ---------------------------------------------------------------- frames and vertices that count


def _without_hovering(spaces: HalfSpaces, fit: Fit, settings: ShapeSettings) -> Fit:
    """The fit with a loss above the ground that is as narrow as the noise.

    Frames that hover less than `settings.gap` above the ground would draw vertices outward; engines whose friction
    lifts what slides make many. Gaps below the ground are noise alone, and show its size.
    """
    below = -fit.gap[fit.gap < 0]
    if not len(below):
        return fit
    narrow = min(settings.gap, settings.gap_noises * 1.4826 * float(np.median(below)))
    return fit_vertices(spaces, fit.vertices, np.zeros(3), replace(settings, gap=narrow), gap=settings.gap, level=True)


def merged(points: Array, distance: float) -> Array:
    """Means of clusters of points, which lie farther apart than a distance (average linkage).

    Args:
        points: (n, 3), two or more [m].
        distance: Between clusters [m].
    """
    label = fcluster(linkage(points, "average"), distance, "distance") - 1
    count = np.bincount(label)
    return np.column_stack([np.bincount(label, points[:, i]) / count for i in range(3)])


def _with_fewer(spaces: HalfSpaces, fit: Fit, settings: ShapeSettings) -> Fit:
    """The fit without the vertices that cost least to leave out: a share of many, the best choice of one of few."""
    reach = np.sort(spaces.down @ fit.vertices.T, axis=1)[:, -2:]
    base = spaces.height - ground_slope(spaces) @ fit.ground
    one, two = (loss_of(base - reach[:, k], spaces.free, settings.gap, settings) for k in (0, 1))
    costs = one - two
    cost = np.bincount(fit.lowest, costs, minlength=len(fit.vertices))
    cheapest, n = np.argsort(cost), len(cost)
    left_out = [cheapest[j : j + 1] for j in range(3)]
    if n > settings.careful_below:
        left_out = [cheapest[: min(max(1, int(settings.dropped_share * n)), n - settings.careful_below)]]
    others = [
        fit_vertices(spaces, np.delete(fit.vertices, j, axis=0), fit.ground, settings, gap=2 * settings.gap)
        for j in left_out
    ]
    return min(others, key=lambda other: other.loss)


def _fewest(spaces: HalfSpaces, fits: Sequence[Fit], settings: ShapeSettings) -> Fit:
    """The fit of least Bayesian information criterion, with the contacts' own scatter for the noise."""
    first = fits[0]
    touches = (np.abs(first.gap) < settings.contact_gap) & ~spaces.free
    if not touches.any():
        return fits[-1]
    scale = max(1.0, (1.4826 * np.median(np.abs(first.gap[touches])) / settings.noise) ** 2)
    price = 3 * np.log(touches.sum())
    return min(fits, key=lambda fit: fit.loss / scale + price * len(fit.vertices))


def price_of(gap: Array, free: NDArray[np.bool_], settings: ShapeSettings) -> tuple[float, float]:
    """Scale of a fit's loss and price of a number of it, for the Bayesian information criterion.

    Args:
        gap: (n,) distance of the fit's lowest point from the ground in each frame [m].
        free: (n,) frames that are no contacts.
        settings: Noise, and what is a contact.
    """
    touches = _touches(gap, free, settings)
    spread = 1.4826 * float(np.median(np.abs(gap[touches]))) if touches.any() else settings.noise
    return max(1.0, (spread / settings.noise) ** 2), float(np.log(max(2, touches.sum())))


def _touches(gap: Array, free: NDArray[np.bool_], settings: ShapeSettings) -> NDArray[np.bool_]:
    return (np.abs(gap) < settings.contact_gap) & ~free


def _rounder(spaces: HalfSpaces, sharp: Fit, hull: Array, settings: ShapeSettings) -> RoundShape | None:
    """The round shape that explains the frames better than the polytope does; None where none does."""
    which = evenly(len(spaces.height), settings.round_frames)
    drawn = spaces.chosen(which)
    thinned = len(spaces.height) / len(drawn.height)
    shapes = list(round_shapes(drawn, hull, settings, loss=loss_of, weights=weights_of))
    # a shape that does not fit shows few contacts: noise and number are those of the one that shows the most
    fits = [sharp.gap[which], *(shape.gap for shape in shapes)]
    scale, price = price_of(max(fits, key=lambda gap: _touches(gap, drawn.free, settings).sum()), drawn.free, settings)
    price += np.log(thinned)
    best, least = None, sharp.loss / scale + 3 * len(sharp.vertices) * price
    for shape in shapes:
        criterion = thinned * shape.loss / scale + shape.size * price
        if criterion < least:
            best, least = shape, criterion
    return best


def _round_shape(
    spaces: HalfSpaces, found: RoundShape, hull: Array, *, unseen: float, settings: ShapeSettings
) -> ConvexShape:
    """A round shape with many points of its surface, and which of them contacts show."""
    ways = directions(HULL_POINTS)
    gap = spaces.height - support(found.corner_pos, found.roundness, spaces.down)
    touches = (np.abs(gap) < settings.contact_gap) & ~spaces.free
    misfit = float(np.sqrt(np.mean(gap[touches] ** 2)))
    slope = found.slope(ways)
    deviation = misfit * np.sqrt(np.maximum(np.einsum("ki,ij,kj->k", slope, found.covariance, slope), 0))
    frames = (ways @ spaces.down[touches].T > np.cos(settings.seen_angle)).sum(axis=1)
    beyond = (hull @ _DIRECTIONS.T - support(found.corner_pos, found.roundness, _DIRECTIONS)).max(axis=1)
    return ConvexShape(
        surface(found.corner_pos, found.roundness, ways), deviation, frames, hull[beyond > unseen], np.zeros(3), misfit,
        found.kind, found.corner_pos, found.roundness,
    )  # fmt: skip


def _without_flat(spaces: HalfSpaces, fit: Fit, settings: ShapeSettings) -> Fit:
    """The fit without vertices that hardly stand out from the others' hull: noise and roundness split corners."""
    while len(fit.vertices) > 4:
        out = np.array([protrusion(x, np.delete(fit.vertices, i, axis=0)) for i, x in enumerate(fit.vertices)])
        if out.min() > settings.feature_rel * 2 * np.abs(fit.vertices - fit.vertices.mean(axis=0)).max():
            break
        fewer = np.delete(fit.vertices, out.argmin(), axis=0)
        fit = fit_vertices(spaces, fewer, fit.ground, settings, gap=2 * settings.gap)
    return fit


def _certainty(
    spaces: HalfSpaces, fit: Fit, touches: NDArray[np.bool_], misfit: float
) -> tuple[Array, NDArray[np.int64]]:
    """Standard error of each vertex in its least certain direction [m], and the contacts that show it."""
    n = len(fit.vertices)
    frames = np.bincount(fit.lowest[touches], minlength=n)
    deviation = np.full(n, np.inf)
    for i in range(n):
        seen = spaces.down[touches & (fit.lowest == i)]
        least = np.linalg.eigvalsh(seen.T @ seen)[0] if len(seen) else 0.0
        if least > 0:
            deviation[i] = misfit / np.sqrt(least)
    return deviation, frames


_DIRECTIONS = np.random.default_rng(0).normal(size=(2000, 3))
_DIRECTIONS /= np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)
