"""Poses and covariances of bodies that hang on others by hinges, from the optimised graph."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from tossid.vision.pose_graph.priors import body_key, joint_key
from tossid.vision.pose_graph.scene import Scene
from tossid.vision.pose_graph.solution import Solution
from tossid.vision.pose_graph.solver.optimise import Marginals
from tossid.vision.setup.hinge import Hinge, Hinges
from tossid.vision.setup.layout import chain, descendants

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


def update_descendants(
    scene: Scene, solution: Solution, root: int, steps: Ints, values: gtsam.Values, marginals: Marginals | None
) -> None:
    """Put into the solution the poses and covariances of all bodies that hang on one.

    Args:
        scene: The set-up.
        solution: Changed.
        root: Number of the body that the others hang on.
        steps: Time steps that were optimised, (k,).
        values: Optimised values.
        marginals: Their covariances; None to leave covariances out.
    """
    links = descendants(scene.bodies, root)
    n, m = len(solution.state.world[root]), len(links)
    tree = solution.tree_cov.setdefault(root, np.full((n, 6 + m, 6 + m), np.nan))
    for step in map(int, steps):
        at = {b: i for i, b in enumerate(links) if values.exists(joint_key(b, step))}
        if not at or not values.exists(body_key(root, step)):
            continue
        if marginals is not None:
            tree[step] = _tree_cov(marginals, body_key(root, step), {joint_key(b, step): i for b, i in at.items()}, m)
        for b in at:
            way = chain(scene.bodies, b)[1]
            if not all(link in at for link in way):
                continue
            angles = [values.atDouble(joint_key(link, step)) for link in way]
            T, J = Hinges.of(hinges_of(scene, way)).swing(values.atPose3(body_key(root, step)).matrix(), angles)
            solution.state.world[b][step] = T
            index = [*range(6), *(6 + at[link] for link in way)]
            solution.world_cov[b][step] = J @ tree[step][np.ix_(index, index)] @ J.T


def _tree_cov(marginals: Marginals, root: int, joints: dict[int, int], m: int) -> Array:
    """(6 + m, 6 + m) of a root's tangent and m angles, NaN of angles that the graph does not have."""
    at = [*range(6), *(6 + i for i in joints.values())]
    cov = np.full((6 + m, 6 + m), np.nan)
    cov[np.ix_(at, at)] = marginals.joint([root, *joints])
    return cov


def hinges_of(scene: Scene, links: list[int]) -> list[Hinge]:
    """The hinges of some bodies.

    Args:
        scene: The set-up.
        links: Numbers of the bodies.
    """
    return [hinge for hinge in (scene.bodies[b].hinge for b in links) if hinge is not None]
