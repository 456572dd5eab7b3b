"""The pose graph: all poses of a scene from what was seen and what was known before, with covariances.

The time steps of a long recording share only what is static. Where that is to be calibrated, a sample of steps
calibrates it in one batch; the steps follow in windows, with the result as their prior, so that memory does not grow
with the recording.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tossid.errors import SolverError
from tossid.vision.pose_graph.batch import Batch, Point
from tossid.vision.pose_graph.least_squares import Eliminated, SingularError, covariances, optimise
from tossid.vision.pose_graph.scene import Scene
from tossid.vision.pose_graph.state import Key, Prior, Solution, State, TimingModel, unsolved
from tossid.vision.pose_graph.unknowns import Problem
from tossid.vision.setup.layout import chain, descendants

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

SAMPLED_STEPS = 20
"""Of a recording longer than a window, so many time steps of each tag and camera, at least, calibrate these."""


def solve(problem: Problem, state: State) -> Solution:
    """The optimal poses of everything that the used sightings show.

    Args:
        problem: What is to be solved.
        state: First poses.

    Raises:
        SolverError: The optimisation does not reach a finite error.
    """
    scene, window = problem.scene, problem.settings.stream.window
    timing = problem.timing or TimingModel.none(scene)
    steps, solution = np.unique(scene.step[problem.used]), unsolved(state, timing.clock)
    for (kind, i), _, covs, at in _statics(scene, solution):
        if problem.is_constant(kind, i):
            covs[at] = 0.0
    if len(steps) <= window:
        _batch(problem, solution, steps, statics=True)
        return solution
    learned: dict[Key, Prior] = {}
    if problem.shares_unknowns or timing.free.any():
        timing, learned = _calibrated(problem, solution, steps, window)
        problem = replace(problem, timing=timing, known={**problem.known, **learned})
    for a in range(0, len(steps), window):
        _batch(problem, solution, steps[a : a + window], statics=False)
    for key, poses, covs, at in _statics(scene, solution):
        if key in learned:  # a window sees less of what is static than the sample did
            poses[at], cov = learned[key].T, learned[key].cov
            covs[at] = 0.0 if cov is None else cov
    return solution


def _calibrated(problem: Problem, solution: Solution, steps: Ints, window: int) -> tuple[TimingModel, dict[Key, Prior]]:
    """Clocks, and prior knowledge of all that is static, from a sample of the steps."""
    scene = problem.scene
    sample = _spread(problem, steps, window)
    _batch(replace(problem, covariances=True), solution, sample, statics=True)
    learned = {
        key: Prior(poses[at].copy(), covs[at].copy() if covs[at].any() else None)
        for key, poses, covs, at in _statics(scene, solution)
        if np.isfinite(covs[at]).all()
    }
    still = TimingModel.none(scene)
    twist = still.twist if problem.timing is None else problem.timing.twist
    return replace(still, twist=twist, clock=solution.clock.copy()), learned


def _spread(problem: Problem, steps: Ints, window: int) -> Ints:
    """Time steps from all over a recording, with some of every tag and every camera."""
    scene, used = problem.scene, problem.used
    chosen = [steps[np.linspace(0, len(steps) - 1, window).astype(np.int64)]]
    for index in (scene.tag, scene.camera):
        for i in np.unique(index[used]):
            own = np.unique(scene.step[used & (index == i)])
            count = min(SAMPLED_STEPS, len(own))
            chosen.append(own[np.linspace(0, len(own) - 1, count).astype(np.int64)])
    return np.unique(np.concatenate(chosen))


def _statics(scene: Scene, solution: Solution) -> list[tuple[Key, Array, Array, int]]:
    """Of all that is static: key, array of poses, array of their covariances, and place in both."""
    state = solution.state
    slots: list[tuple[Key, Array, Array, int]] = []
    slots += [(("camera", c), state.camera, solution.camera_cov, c) for c in range(len(scene.cameras))]
    slots += [(("tag", i), state.tag, solution.tag_cov, i) for i in range(len(scene.tags))]
    statics = [b for b, body in enumerate(scene.bodies) if body.is_static]
    return slots + [(("body", b), state.world[b], solution.world_cov[b], 0) for b in statics]


def _batch(problem: Problem, solution: Solution, steps: Ints, *, statics: bool) -> None:
    """Optimise some steps together, into the solution; `statics`: with prints and measured lengths."""
    batch = Batch(problem, solution.state, steps, statics=statics)
    point = optimise(batch, batch.start)
    found = None
    if problem.covariances:
        try:
            found = covariances(batch.normal(point, scale=problem.scale))
        except SingularError as error:
            what = batch.columns.name_of(batch.scene, error.column)
            raise SolverError(f"the sightings do not determine every pose of the graph (near {what})") from error
    columns, state = batch.columns, solution.state
    state.prints[columns.print >= 0] = point.state.prints[columns.print >= 0]
    solution.clock[:] = np.where(columns.clock >= 0, point.clock, solution.clock)
    if found is not None:
        late = columns.clock >= 0
        solution.clock_sigma[late] = np.sqrt(np.diag(found.cov_s)[columns.clock[late]])
    first = {"camera": columns.camera, "tag": columns.tag, "body": columns.body}
    optimised = _statics(problem.scene, replace(solution, state=point.state))
    for ((kind, i), poses, covs, at), (_, best, _, _) in zip(_statics(problem.scene, solution), optimised, strict=True):
        own = int(first[kind][i])
        if own >= 0:
            poses[at] = best[at]
            if found is not None:
                covs[at] = found.cov_s[own : own + 6, own : own + 6]
    for b, body in enumerate(problem.scene.bodies):
        if not body.is_static and body.hinge is None and columns.body[b] >= 0:
            _update_tree(solution, b, steps, batch, point, found)


def _update_tree(
    solution: Solution, root: int, steps: Ints, batch: Batch, point: Point, found: Eliminated | None
) -> None:
    """Put into the solution the poses and covariances of a moving body and of all that hang on it.

    Args:
        solution: Changed.
        root: Number of the body.
        steps: Time steps that were optimised, (k,).
        batch: The same as a problem.
        point: Optimised values.
        found: Their covariances; None to leave covariances out.
    """
    scene, links, columns = batch.scene, descendants(batch.scene.bodies, root), batch.columns
    seen, at = batch.sees(root), columns.body[root] - columns.shared
    solution.state.world[root][steps[seen]] = point.state.world[root][seen]
    hangs = {link: batch.sees(link) for link in links}
    for link in links:
        solution.state.world[link][steps[hangs[link]]] = point.state.world[link][hangs[link]]
    if found is None:
        return
    n, width = len(solution.state.world[root]), 6 + len(links)
    known = np.ones((len(steps), width), dtype=bool)
    known[:, 6:] = np.stack([hangs[link] for link in links], axis=1) if links else True
    cov = found.cov_k[:, at : at + width, at : at + width]
    solution.world_cov[root][steps[seen]] = cov[seen, :6, :6]
    if links:
        tree = solution.tree_cov.setdefault(root, np.full((n, width, width), np.nan))
        tree[steps[seen]] = np.where(known[:, :, None] & known[:, None, :], cov, np.nan)[seen]
    for link in links:
        J = point.swing[link][hangs[link]]
        index = [*range(6), *(columns.angle[chain(scene.bodies, link)[1]] - columns.shared - at)]
        own = cov[hangs[link]][:, index][:, :, index]
        solution.world_cov[link][steps[hangs[link]]] = J @ own @ np.swapaxes(J, 1, 2)
