"""The pose graph: all poses of a scene from what was seen and what was known before, with covariances (GTSAM)."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from tossid.vision.pose_graph.graph_builder import Problem, build, hinges_of
from tossid.vision.pose_graph.least_squares import joint_covariance, marginals_of, optimise
from tossid.vision.pose_graph.scene import Scene
from tossid.vision.pose_graph.state import (
    Solution,
    State,
    TimingModel,
    body_key,
    camera_key,
    clock_key,
    joint_key,
    print_key,
    tag_key,
    unsolved,
)
from tossid.vision.setup.hinge import stacked, swing
from tossid.vision.setup.layout import chain, descendants

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

INDEPENDENT_WINDOW = 60
"""Time steps that are optimised together where steps share no unknown; the slowest of them sets how often all of them
are linearised."""


def solve(problem: Problem, state: State, *, steps: Ints | None = None) -> Solution:
    """The optimal poses of everything that the used sightings show.

    Args:
        problem: What is to be solved.
        state: First poses.
        steps: Time steps to solve; None for all. The others' poses stay.

    Raises:
        SolverError: The optimisation does not reach a finite error.
    """
    timing = problem.timing or TimingModel.none(problem.scene)
    steps = np.unique(problem.scene.step[problem.used]) if steps is None else steps
    solution = unsolved(state, timing.clock)
    together = problem.shares_unknowns or timing.free.any()
    window = max(len(steps), 1) if together else INDEPENDENT_WINDOW
    for a in range(0, max(len(steps), 1), window):
        _batch(problem, solution, steps[a : a + window])
    return solution


def _statics(scene: Scene, solution: Solution) -> list[tuple[int, Array, Array, int]]:
    """Of all that is static: key, array of poses, array of their covariances, and place in both."""
    state = solution.state
    slots = [(camera_key(c), state.camera, solution.camera_cov, c) for c in range(len(scene.cameras))]
    slots += [(tag_key(i), state.tag, solution.tag_cov, i) for i in range(len(scene.tags))]
    statics = [b for b, body in enumerate(scene.bodies) if body.is_static]
    return slots + [(body_key(b, 0), state.world[b], solution.world_cov[b], 0) for b in statics]


def _batch(problem: Problem, solution: Solution, steps: Ints) -> None:
    """Optimise some steps together, into the solution."""
    scene, state = problem.scene, solution.state
    built = build(problem, state, problem.used & np.isin(scene.step, steps))
    values = built.values if problem.solved else optimise(built.graph, built.values)
    built.noise.scale = problem.scale
    slots, marginals = _statics(scene, solution), None
    if problem.covariances and values.size():
        marginals = marginals_of(built.graph, values)
    for b, body in enumerate(scene.bodies):
        for step in () if body.is_static or body.hinge is not None else steps:
            slots.append((body_key(b, int(step)), state.world[b], solution.world_cov[b], int(step)))
    for key, poses, covs, at in slots:
        if key in built.fixed:
            covs[at] = 0.0
        elif values.exists(key):
            poses[at] = values.atPose3(key).matrix()
            if marginals is not None:
                covs[at] = joint_covariance(marginals, [key])
    for root in range(len(scene.bodies)):
        if descendants(scene.bodies, root):
            _update_descendants(scene, solution, root, steps, values, marginals)
    for i in range(len(scene.tags)):
        if values.exists(print_key(i)):
            state.prints[i] = values.atPoint3(print_key(i))
    free = np.zeros(0) if problem.timing is None else problem.timing.free
    for c in map(int, np.flatnonzero(free)):
        if values.exists(clock_key(c)):
            solution.clock[c] = values.atDouble(clock_key(c))
            if marginals is not None:
                solution.clock_sigma[c] = float(np.sqrt(joint_covariance(marginals, [clock_key(c)])[0, 0]))


def _update_descendants(
    scene: Scene, solution: Solution, root: int, steps: Ints, values: gtsam.Values, marginals: gtsam.Marginals | None
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
            angles = np.array([values.atDouble(joint_key(link, step)) for link in way])
            T_root = np.ascontiguousarray(values.atPose3(body_key(root, step)).matrix())
            T, J = swing(T_root, *stacked(hinges_of(scene, way)), angles)
            solution.state.world[b][step] = T
            index = [*range(6), *(6 + at[link] for link in way)]
            solution.world_cov[b][step] = J @ tree[step][np.ix_(index, index)] @ J.T


def _tree_cov(marginals: gtsam.Marginals, root: int, joints: dict[int, int], m: int) -> Array:
    """(6 + m, 6 + m) of a root's tangent and m angles, NaN of angles that the graph does not have."""
    at = [*range(6), *(6 + i for i in joints.values())]
    cov = np.full((6 + m, 6 + m), np.nan)
    cov[np.ix_(at, at)] = joint_covariance(marginals, [root, *joints])
    return cov
