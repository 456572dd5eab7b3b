"""Two links on a hinge as one falling object: what motion shows of their masses.

With masses m_b of M in all, centres of mass r_b in the links' frames, and the hinge at a in link 1's frame and at b in
link 2's, the common centre of mass is at

    p_1 + R_1 c_1 + R_2 c_2,    M c_1 = m_1 r_1 + m_2 a,    M c_2 = m_2 (r_2 - b).

The parts c_1 and c_2 are all that flight shows of r_1, r_2 and m_2 / m_1. Along the hinge's axis e only the sum
c_1 · e + c_2 · e shows, since R_1 and R_2 turn e alike. The mass ratio shows nowhere, not in contact either: mass on
the axis may belong to either link. In all functions, `tree` is one rigid body or two links on a hinge.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tossid.objects import ObjectModel, body_poses
from tossid.rotations import quat_rotate, quat_to_matrix
from tossid.types import PoseTrack, Toss

Array = NDArray[np.float64]


def turns(tree: ObjectModel, q: Array) -> Array:
    """The rotations of all bodies side by side at configurations (n, nq): (n, 3, 3 n_b)."""
    R = quat_to_matrix(body_poses(tree, q)[1])
    return np.asarray(np.moveaxis(R, 1, 2).reshape(len(q), 3, -1))


def body_tracks(tree: ObjectModel, tosses: Sequence[Toss | PoseTrack]) -> list[list[PoseTrack]]:
    """The tracks of each body by itself, (n, 7) each."""
    tracks: list[list[PoseTrack]] = [[] for _ in range(tree.n_bodies)]
    for toss in tosses:
        poses = np.concatenate(body_poses(tree, toss.q), axis=-1)
        for body, own in enumerate(tracks):
            own.append(PoseTrack(toss.name, toss.t, poses[:, body]))
    return tracks


def determined(tree: ObjectModel) -> Array:
    """Directions (3 n_b, r) of the parts c_b that flight determines: all but one along the hinge's axis."""
    if not tree.n_joints:
        return np.eye(3)
    axis = np.concatenate([-quat_rotate(tree.body_quat[1], tree.joint_axis[1]), tree.joint_axis[1]])
    return np.asarray(np.linalg.svd(axis[None])[2][1:].T)


def moments_of_com(tree: ObjectModel, com: Array, mass: Array) -> Array:
    """The parts c_b of the common centre of mass (n_b, 3), from each body's own (n_b, 3) [m] and mass (n_b,) [kg]."""
    share = mass / mass.sum()
    parts = share[:, None] * (com - _origins(tree))
    if tree.n_joints:
        parts[0] += share[1] * (tree.body_pos[1] + quat_rotate(tree.body_quat[1], tree.joint_pos[1]))
    return np.asarray(parts)


def com_of_moments(tree: ObjectModel, parts: Array, mass: Array) -> Array:
    """Each body's centre of mass in its frame, (n_b, 3) [m]: the inverse of `moments_of_com`."""
    origins = _origins(tree)
    by_hinge = moments_of_com(tree, origins, mass)
    return np.asarray(origins + (parts - by_hinge) * (mass.sum() / mass)[:, None])


def _origins(tree: ObjectModel) -> Array:
    """From where each body's part is counted, in its frame: the base's origin, and the hinge. (n_b, 3) [m]."""
    return np.concatenate([np.zeros((1, 3)), tree.joint_pos[1:]])
