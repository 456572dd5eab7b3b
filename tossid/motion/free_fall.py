"""Centre of mass and gravity of a rigid body from its free fall, with no other knowledge of it.

In flight the centre of mass c (in the body's frame) moves on a parabola: p + R c = a + b t - g t²/2 e_z, with p and R
the body's recorded position and rotation. Of two links on a hinge, p + R_1 c_1 + R_2 c_2 moves so, with the parts c_b
of the common centre of mass (`tossid.motion.links`); along the hinge's axis only their sum shows. For each stretch of
flight, a and b are eliminated by projecting on the orthogonal complement of (1, t); c and g are the same for all
stretches, so that linear least squares give them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.motion.links import determined, turns
from tossid.objects import ObjectModel
from tossid.settings.motion import FreeFallSettings
from tossid.types import Toss

Array = NDArray[np.float64]

DEFAULT = FreeFallSettings()


@dataclass(frozen=True)
class FreeFall:
    """What flight shows of a rigid body, or of two links.

    Attributes:
        com: Centre of mass in the body's frame, or each link's part c_b of it [m], (n_b, 3).
        com_deviation: Their standard errors [m], (n_b, 3).
        gravity: Downward acceleration [m/s²].
        gravity_deviation: Its standard error [m/s²].
        stretches: How many stretches of flight there are.
    """

    com: Array
    com_deviation: Array
    gravity: float
    gravity_deviation: float
    stretches: int


def free_fall(
    tosses: Sequence[Toss],
    tree: ObjectModel,
    clearance: Callable[[Toss], Array],
    settings: FreeFallSettings = DEFAULT,
) -> FreeFall:
    """Centre of mass and gravity from all stretches of flight.

    A stretch that is no free fall (a hand, a collision) counts less: Huber's weights on the stretches' rms residuals.

    Args:
        tosses: Of one rigid body, or of two links on a hinge.
        tree: The body, or the links and their hinge; nothing else of it matters.
        clearance: Height of the object's lowest point above the ground in each frame of a toss [m], (n,).
        settings: What is flight.

    Returns:
        Estimates with standard errors, the stretch being the unit (a sandwich estimate).

    Raises:
        InputError: There is too little flight.
    """
    free = determined(tree)
    stretches = [part for toss in tosses for part in _stretches(toss, tree, free, clearance(toss), settings)]
    if len(stretches) < settings.fewest_stretches:
        raise InputError(
            f"{len(stretches)} stretches of flight of at least {settings.fewest_frames} frames; "
            f"a centre of mass needs at least {settings.fewest_stretches}"
        )
    normal = np.array([J.T @ J for J, _ in stretches])
    right = np.array([J.T @ y for J, y in stretches])
    weights = np.ones(len(stretches))
    for _ in range(settings.iterations):
        H = np.einsum("s,sij->ij", weights, normal)
        if np.linalg.cond(H) > settings.worst_condition:
            raise InputError("the body hardly turns in flight: its centre of mass cannot be told from its position")
        found = np.linalg.solve(H, np.einsum("s,si->i", weights, right))
        rms = np.array([np.sqrt(np.mean((y - J @ found) ** 2)) for J, y in stretches])
        weights = 1 / np.maximum(1, rms / (settings.huber * np.median(rms)))
    score = np.array([w * J.T @ (y - J @ found) for w, (J, y) in zip(weights, stretches, strict=True)])
    inverse = np.linalg.inv(H)
    covariance = inverse @ (score.T @ score) @ inverse
    deviation = np.sqrt(np.diag(covariance))
    com = (free @ found[:-1]).reshape(-1, 3)
    com_deviation = np.sqrt(np.diag(free @ covariance[:-1, :-1] @ free.T)).reshape(-1, 3)
    return FreeFall(com, com_deviation, float(found[-1]), float(deviation[-1]), len(stretches))


def _stretches(
    toss: Toss, tree: ObjectModel, free: Array, clearance: Array, settings: FreeFallSettings
) -> list[tuple[Array, Array]]:
    """Derivatives (3 n, r + 1) and right sides (3 n,) of each stretch of flight, its own line in time taken out.

    free: (3 n_b, r), what is determined of the parts c_b.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], clearance > settings.clearance, [0]]).astype(int)))
    R, r = turns(tree, toss.q) @ free, free.shape[1]
    found = []
    for first, last in zip(edges[::2] + settings.margin, edges[1::2] - settings.margin, strict=True):
        n = last - first
        if n < settings.fewest_frames:
            continue
        t = toss.t[first:last] - toss.t[first]
        line = np.column_stack([np.ones(n), t])
        apart = np.eye(n) - line @ np.linalg.pinv(line)
        J = np.zeros((3, n, r + 1))
        J[:, :, :r] = -R[first:last].transpose(1, 0, 2)
        J[2, :, r] = -0.5 * t**2
        found.append(((apart @ J).reshape(-1, r + 1), (apart @ toss.q[first:last, :3]).T.reshape(-1)))
    return found
