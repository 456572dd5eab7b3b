"""Convex shapes of links that are joined, from nothing but their poses over one ground.

Each link has its own half-spaces, as a single body has (`tossid.objects.convex_shape`). But a link may be kept from the
ground by another link. Its half-spaces are then tight in frames in which it touches nothing, and its polytope gets
vertices where the other link's corners pass. One contact explains a frame: so vertices are left out, over all links
together, as long as the lowest of the others explains the frames as well (Bayesian information criterion).

What is left lacks corners that never touch alone, such as those at the hinge. A link is completed with where its
half-spaces let it reach, but no farther along the hinge and across it than its other corners do. No contact shows these
corners: their number of contacts is 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from tossid.objects.convex_shape import UNSEEN, ConvexShape, sharp_shape
from tossid.objects.half_spaces import HalfSpaces, different, half_spaces, hull_in_box, protrusion
from tossid.objects.polytope import (
    CONTACT_GAP,
    GAP,
    bic_terms,
    find_polytope,
    fit_over_level_ground,
    loss_of,
    merged,
)
from tossid.types import PoseTrack, Toss

Array = NDArray[np.float64]


def find_linked_shapes(
    links: Sequence[Sequence[Toss | PoseTrack]],
    axes: Sequence[Array],
    *,
    flying: Sequence[NDArray[np.bool_]] | None = None,
) -> tuple[ConvexShape, ...]:
    """The convex polytope of each link.

    Args:
        links: The tracks of each link, (n, 7) each, at the same times, over the ground z = 0.
        axes: The hinge's axis in each link's frame, (3,) unit.
        flying: Frames of each toss that are known to be in free flight.

    Returns:
        A shape a link. Corners that no contact shows have no `frames`; `unseen` says where the link may reach beyond.

    Raises:
        InputError: The poses bound no shape, or there is too little contact.
    """
    every = [half_spaces(link, flying) for link in links]
    alone = [find_polytope(spaces) for spaces in every]
    fits = [fit_over_level_ground(each.near, each.fit.vertices) for each in alone]
    frames = _different_together(every)
    while True:
        terms = bic_terms(fits[0].gap, alone[0].near.free)
        vertices = _without_explained(frames, [fit.vertices for fit in fits], *terms)
        fewer = [len(own) < len(fit.vertices) for fit, own in zip(fits, vertices, strict=True)]
        for link in np.flatnonzero(fewer):
            fits[link] = fit_over_level_ground(alone[link].near, vertices[link])
        if not any(fewer):
            break
    shapes = []
    for spaces, axis, each, fit in zip(every, axes, alone, fits, strict=True):
        unseen, hull = UNSEEN * each.radius, merged(each.hull, each.radius)
        shape = sharp_shape(each.near, fit, hull, unseen=unseen, ground=each.fit.ground)
        shapes.append(_completed(shape, spaces, axis, unseen, each.radius))
    return tuple(shapes)


def contacts_alone(
    links: Sequence[Sequence[Toss | PoseTrack]], shapes: Sequence[ConvexShape]
) -> list[NDArray[np.int64]]:
    """How many different contacts show each vertex of each link while no other link touches.

    Args:
        links: The tracks of each link, as of `find_linked_shapes`.
        shapes: Of the links.
    """
    frames = _different_together([half_spaces(link) for link in links])
    touches = [
        np.abs(spaces.height - shape.reach(spaces.down)) < CONTACT_GAP
        for spaces, shape in zip(frames, shapes, strict=True)
    ]
    out = []
    for link, (spaces, shape) in enumerate(zip(frames, shapes, strict=True)):
        others = np.any([touch for k, touch in enumerate(touches) if k != link], axis=0)
        lowest = (spaces.down @ shape.vertices.T).argmax(axis=1)
        out.append(np.bincount(lowest[touches[link] & ~others], minlength=len(shape.vertices)))
    return out


def _different_together(every: Sequence[HalfSpaces]) -> list[HalfSpaces]:
    """The same frames of all links: those in which any link differs from before."""
    kept = np.any([different(spaces) for spaces in every], axis=0)
    return [spaces.chosen(kept) for spaces in every]


def _completed(shape: ConvexShape, spaces: HalfSpaces, axis: Array, least: float, radius: float) -> ConvexShape:
    """A shape with corners that no contact shows: where half-spaces let it reach, within the extent of the others.

    axis: of the hinge. least: how far a corner stands out [m]. radius: of the largest ball inside the outer hull [m].
    """
    own = shape.vertices
    box = _box_along(axis, own)
    at = own @ box.T
    points = merged(hull_in_box(spaces, at.min(axis=0), at.max(axis=0), box), radius)
    vertices = own
    while (out := protrusion(points, vertices)).max() >= least:
        vertices = np.concatenate([vertices, points[[out.argmax()]]])
    added = len(vertices) - len(own)
    return replace(
        shape,
        vertices=vertices,
        deviation=np.concatenate([shape.deviation, np.full(added, np.inf)]),
        frames=np.concatenate([shape.frames, np.zeros(added, dtype=np.int64)]),
        unseen=shape.unseen[protrusion(shape.unseen, vertices) > least],
    )


def _box_along(axis: Array, points: Array) -> Array:
    """Axes (3, 3) of the smallest box about points of which one axis is given: another is across one of their edges."""
    across = np.linalg.svd(axis[None])[2][1:]
    flat = points @ across.T
    edges = np.diff(flat[ConvexHull(flat).simplices], axis=1)[:, 0]
    edges /= np.linalg.norm(edges, axis=1, keepdims=True)
    size = [np.ptp(flat @ way) * np.ptp(flat @ [-way[1], way[0]]) for way in edges]
    way = edges[int(np.argmin(size))]
    return np.concatenate([axis[None], np.array([way, [-way[1], way[0]]]) @ across])


def _without_explained(frames: Sequence[HalfSpaces], vertices: list[Array], scale: float, price: float) -> list[Array]:
    """Vertices of each link without those whose frames other vertices, of any link, explain as well.

    scale, price: of the Bayesian information criterion.
    """
    free = frames[0].free
    while True:
        reach = [spaces.down @ own.T for spaces, own in zip(frames, vertices, strict=True)]
        gaps = [spaces.height - np.max(own, axis=1) for spaces, own in zip(frames, reach, strict=True)]
        now, best, cost = loss_of(np.min(gaps, axis=0), free, GAP), None, 3 * price * scale
        for link, own in enumerate(vertices):
            others = np.min([gap for k, gap in enumerate(gaps) if k != link], axis=0)
            lowest, second = reach[link].argmax(axis=1), np.sort(reach[link], axis=1)[:, -2]
            without = loss_of(np.minimum(frames[link].height - second, others), free, GAP)
            costs = np.bincount(lowest, without - now, minlength=len(own))
            if len(own) > 4 and costs.min() < cost:
                best, cost = (link, int(costs.argmin())), float(costs.min())
        if best is None:
            return vertices
        vertices = [np.delete(own, best[1], axis=0) if k == best[0] else own for k, own in enumerate(vertices)]
