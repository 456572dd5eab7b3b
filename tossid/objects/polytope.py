"""A polytope of few vertices over the ground, from half-spaces: a max-affine regression of the support function.

A frame bounds the support function h(d) = max_x d · x of the object by p_z, and equals it in contact. Each frame is
assigned to the vertex that is lowest in it, and vertices are fitted to their frames (Magnani and Boyd, "Convex
piecewise-linear fitting", 2009). A frame that is no contact has a gap, which a redescending loss leaves out. Of the
hundreds of vertices of the outer hull, those stay that the Bayesian information criterion asks for.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import fcluster, linkage

from tossid.objects.half_spaces import Bools, HalfSpaces, different, evenly, outer_hull, protrusion
from tossid.robust import NORMAL_MAD

Array = NDArray[np.float64]

NOISE = 3e-4
"""Standard deviation of the recorded heights of a corner [m]."""
GAP, FIRST_GAP = 1e-3, 4e-3
"""Scale of the loss above the ground [m]: higher frames count less and less as contacts. It falls from the second, as
vertices begin far from where they belong, to the first."""
CONTACT_GAP = 1.5e-3
"""Largest distance of the lowest vertex from the ground in a frame that is counted as a contact [m]."""
CONVERGED = 2e-6
"""Change of a vertex below which a fit ends [m]."""
ITERATIONS = 40
_NEAR, _MERGED = 0.5, 0.15
"""Shares of the radius of the largest ball inside the outer hull: of the gap to the hull below which frames take part,
and of the distance below which vertices of the hull are one vertex to begin with."""
_FEATURE = 0.02
"""Share of the largest extent by which a vertex must stand out from the hull of the others."""
_MOST_FRAMES = 4000
"""Frames, evenly drawn, from which the number of vertices is found; the last fit takes all."""
_CAREFUL, _DROPPED = 16, 0.1
"""Number of vertices up to which they are left out one by one, the best of three ways each time, and the share of them
that is left out at once while there are more."""
_HOLD = 0.3
"""Weight of where a vertex was, in frames: it holds vertices that few frames show."""


class Fit(NamedTuple):
    """Vertices that were fitted.

    Attributes:
        vertices: (n, 3) [m].
        ground: (3,) height at the origin [m] and slopes along x and y.
        lowest: (k,) the lowest vertex of each frame.
        gap: (k,) its height over the ground [m].
        loss: Sum over frames.
    """

    vertices: Array
    ground: Array
    lowest: NDArray[np.int64]
    gap: Array
    loss: float


class Polytope(NamedTuple):
    """What frames show of a polytope.

    Attributes:
        near: Frames near the ground that differ.
        fit: Vertices, and the ground that they fit best.
        hull: (m, 3) vertices of the outer hull [m].
        radius: Of the largest ball inside it [m].
    """

    near: HalfSpaces
    fit: Fit
    hull: Array
    radius: float


def find_polytope(every: HalfSpaces) -> Polytope:
    """The polytope and the ground that fit frames best.

    Raises:
        InputError: The poses bound no shape.
    """
    near, drawn, start, hull, radius = _candidates(every, every)
    fits = [fit_vertices(drawn, start, np.zeros(3), gap=FIRST_GAP)]
    while len(fits[-1].vertices) > 4:
        fits.append(_with_fewer(drawn, fits[-1]))
    chosen = _without_flat(drawn, _fewest(drawn, fits))
    return Polytope(near, fit_vertices(near, chosen.vertices, chosen.ground, gap=2 * GAP), hull, radius)


def sloping_ground(every: HalfSpaces, slack: float) -> Array:
    """The ground's height at the origin [m] and its slopes along x and y, (3,), where the slopes are large.

    Args:
        every: All frames.
        slack: Slope that the ground may have: each half-space is first moved out by it times the distance from the
            middle of all places.

    Raises:
        InputError: The poses bound no shape.
    """
    far = slack * np.linalg.norm(every.place - np.median(every.place, axis=0), axis=1)
    _, drawn, start, *_ = _candidates(every, every._replace(height=every.height + far))
    return fit_vertices(drawn, start, np.zeros(3), gap=float(np.quantile(far, 0.9))).ground


def _candidates(every: HalfSpaces, bounding: HalfSpaces) -> tuple[HalfSpaces, HalfSpaces, Array, Array, float]:
    """Frames near the ground, some of them, vertices to begin with, the outer hull of `bounding` and its radius."""
    _, radius, hull = outer_hull(bounding)
    near = every.chosen(different(every))
    near = near.chosen(near.height - (near.down @ hull.T).max(axis=1) < _NEAR * radius)
    return near, near.chosen(evenly(len(near.height), _MOST_FRAMES)), merged(hull, radius), hull, radius


def merged(points: Array, radius: float) -> Array:
    """Means of clusters of points (n, 3) [m], which lie farther apart than a share of a radius (average linkage)."""
    label = fcluster(linkage(points, "average"), _MERGED * radius, "distance") - 1
    count = np.bincount(label)
    return np.column_stack([np.bincount(label, points[:, i]) / count for i in range(3)])


def touching(gap: Array, free: Bools) -> Bools:
    """Frames (n,) that are contacts, given their gaps [m] and whether they are known to fly freely."""
    return (np.abs(gap) < CONTACT_GAP) & ~free


def bic_terms(gap: Array, free: Bools) -> tuple[float, float]:
    """Scale of a fit's loss, and price of each of its numbers, for the Bayesian information criterion.

    Args:
        gap: (n,) distance of the fit's lowest point from the ground in each frame [m].
        free: (n,) frames that are no contacts.
    """
    touches = touching(gap, free)
    spread = NORMAL_MAD * float(np.median(np.abs(gap[touches]))) if touches.any() else NOISE
    return max(1.0, (spread / NOISE) ** 2), float(np.log(max(2, touches.sum())))


# ---------------------------------------------------------------- fewer vertices


def _with_fewer(spaces: HalfSpaces, fit: Fit) -> Fit:
    """The fit without the vertices that cost least to leave out: a share of many, the best choice of one of few."""
    reach = np.sort(spaces.down @ fit.vertices.T, axis=1)[:, -2:]
    base = spaces.height - ground_slope(spaces) @ fit.ground
    # what a frame costs without its lowest vertex is its loss at the second lowest
    one, two = (loss_of(base - reach[:, k], spaces.free, GAP) for k in (0, 1))
    cost = np.bincount(fit.lowest, one - two, minlength=len(fit.vertices))
    cheapest, n = np.argsort(cost), len(cost)
    left_out = [cheapest[j : j + 1] for j in range(3)]
    if n > _CAREFUL:
        left_out = [cheapest[: min(max(1, int(_DROPPED * n)), n - _CAREFUL)]]
    others = [fit_vertices(spaces, np.delete(fit.vertices, j, axis=0), fit.ground, gap=2 * GAP) for j in left_out]
    return min(others, key=lambda other: other.loss)


def _fewest(spaces: HalfSpaces, fits: Sequence[Fit]) -> Fit:
    """The fit of least Bayesian information criterion, with the contacts' own scatter for the noise."""
    if not touching(fits[0].gap, spaces.free).any():
        return fits[-1]
    scale, price = bic_terms(fits[0].gap, spaces.free)
    return min(fits, key=lambda fit: fit.loss / scale + 3 * price * len(fit.vertices))


def _without_flat(spaces: HalfSpaces, fit: Fit) -> Fit:
    """The fit without vertices that hardly stand out from the others' hull: noise and roundness split corners."""
    while len(fit.vertices) > 4:
        out = [protrusion(x[None], np.delete(fit.vertices, i, axis=0))[0] for i, x in enumerate(fit.vertices)]
        if min(out) > _FEATURE * 2 * np.abs(fit.vertices - fit.vertices.mean(axis=0)).max():
            break
        fewer = np.delete(fit.vertices, int(np.argmin(out)), axis=0)
        fit = fit_vertices(spaces, fewer, fit.ground, gap=2 * GAP)
    return fit


# ---------------------------------------------------------------- the fit


def loss_of(gap: Array, free: Bools, scale: float) -> Array:
    """Loss of each gap: Huber's below the ground, Geman and McClure's above, none in free flight; in variances."""
    knee = 2 * NOISE
    below = np.where(gap > -knee, gap**2, -2 * knee * gap - knee**2)
    above = np.where(free, 0.0, scale**2 * gap**2 / (scale**2 + gap**2))
    return np.where(gap < 0, below, above) / NOISE**2


def weights_of(gap: Array, free: Bools, scale: float) -> Array:
    """Weights of the least squares that have the loss's gradient."""
    above = np.where(free, 0.0, 1 / (1 + (gap / scale) ** 2) ** 2)
    return np.where(gap < 0, 1 / np.maximum(1, -gap / (2 * NOISE)), above)


def ground_slope(spaces: HalfSpaces) -> Array:
    """Derivative of the ground's height under the body with respect to its height at the origin and its slopes."""
    return np.column_stack([np.ones(len(spaces.height)), spaces.place])


def fit_vertices(
    spaces: HalfSpaces, start: Array, ground: Array, *, gap: float, level: bool = False, last_gap: float = GAP
) -> Fit:
    """Fit vertices, and the ground unless it is level, by reweighted least squares.

    Args:
        spaces: Frames near the ground.
        start: Vertices to begin with, (n, 3).
        ground: The ground to begin with, (3,).
        gap: Scale of the loss above the ground to begin with [m].
        level: The ground is z = 0.
        last_gap: What the scale falls to [m].
    """
    X, g, G, n = start.copy(), ground.copy(), ground_slope(spaces), len(start)
    for _ in range(ITERATIONS):
        gap = max(last_gap, 0.8 * gap)
        lowest, r = _residuals(spaces, G, X, g)
        w = weights_of(r, spaces.free, gap)
        rise, turn = _gauss_newton_step(spaces.down, G, w, r, lowest, n, level=level)
        X += rise
        g += turn
        if gap == last_gap and max(np.abs(rise).max(), np.abs(turn).max()) < CONVERGED:
            break
    lowest, r = _residuals(spaces, G, X, g)
    return Fit(X, g, lowest, r, float(loss_of(r, spaces.free, last_gap).sum()))


def fit_over_level_ground(spaces: HalfSpaces, vertices: Array) -> Fit:
    """Fit vertices (n, 3) [m] to frames over the ground z = 0, from near where they belong."""
    return fit_vertices(spaces, vertices, np.zeros(3), gap=2 * GAP, level=True)


def _residuals(spaces: HalfSpaces, G: Array, X: Array, g: Array) -> tuple[NDArray[np.int64], Array]:
    """The lowest vertex of each frame, and its gap [m]."""
    reach = spaces.down @ X.T
    lowest = reach.argmax(axis=1)
    return lowest, spaces.height - G @ g - reach[np.arange(len(lowest)), lowest]


def _gauss_newton_step(
    down: Array, G: Array, w: Array, r: Array, lowest: NDArray[np.int64], n: int, *, level: bool
) -> tuple[Array, Array]:
    """The step of vertices (n, 3) and ground (3,), zero where it is level.

    A frame depends on one vertex and the ground, so that the vertices' 3 x 3 blocks are eliminated first.
    """

    def sums(values: Array, others: Array) -> Array:
        """Weighted sums of products over each vertex's frames, (n, ., .)."""
        products = [np.bincount(lowest, w * a * b, minlength=n) for a in values.T for b in others.T]
        return np.asarray(np.stack(products, axis=-1).reshape(n, values.shape[1], others.shape[1]), dtype=float)

    A, b = sums(down, down) + _HOLD * np.eye(3), sums(down, r[:, None])
    if level:
        return np.asarray(np.linalg.solve(A, b)[..., 0]), np.zeros(3)
    # normal equations [A C; Cᵀ D], A of blocks: its Schur complement gives the ground, and that the vertices
    C = sums(down, G)
    solved = np.linalg.solve(A, np.concatenate([b, C], axis=-1))
    own, by_ground = solved[..., 0], solved[..., 1:]
    left = (G * w[:, None]).T @ G + 1e-9 * np.eye(3) - np.einsum("nij,nik->jk", C, by_ground)
    turn = np.linalg.solve(left, G.T @ (w * r) - np.einsum("nij,ni->j", C, own))
    return own - by_ground @ turn, turn
