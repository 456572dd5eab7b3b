"""The poses of a scene by the graph, robustly: outliers left out, clocks refined, tags modelled, the set-up checked."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tossid.rotations import matrix_to_quat, quat_boxminus
from tossid.settings.tracking import TrackSettings
from tossid.vision.pose_graph.factors import IDEAL_TAGS, TagModel
from tossid.vision.pose_graph.graph import solve
from tossid.vision.pose_graph.graph_builder import Problem
from tossid.vision.pose_graph.initial import initialise, place
from tossid.vision.pose_graph.reprojection import ReprojectionErrors, reproject
from tossid.vision.pose_graph.scene import Scene, gap
from tossid.vision.pose_graph.setup_checks import Suspect, check_set_up
from tossid.vision.pose_graph.state import (
    Prior,
    Solution,
    TimingModel,
    given,
    is_known,
    priors,
    tag_key,
    unsolved,
)
from tossid.vision.pose_graph.tag_distortion import converged, estimate_tag_model

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

OUTLIER_PIXELS = 0.5
"""Rms reprojection up to which no sighting is an outlier [px]."""
COVARIANCE_SLACK = 1.2
"""Covariances are scaled by the residuals' noise where that differs from the corners' own by more than this factor;
errors such as edges that spread are in the residuals and not in the pose."""
TAG_MODEL_PASSES = 6
"""Most alternations between poses and tag model."""
NOISE_SHARE = 0.75
"""The tag model is kept where it brings the noise below this share of the plain model's."""
LEFT_OUT_SHARE, RESIDUAL_RATIO = 0.02, 1.5
"""Share of sightings that contradict the others, and residuals over the noise, from which the set-up is checked."""


@dataclass(frozen=True, eq=False)
class SolvedScene:
    """The poses of a scene, and what they rest on.

    Attributes:
        scene: The sightings.
        solution: Poses with covariances.
        errors: Their reprojection.
        used: Sightings that are no outliers, (d,).
        scale: The residuals' noise over the corners' own.
        tag_model: How tags differ from flat squares.
        outliers: Sightings that contradict the others of their step.
        suspects: Parts of the set-up that the images contradict.
    """

    scene: Scene
    solution: Solution
    errors: ReprojectionErrors
    used: Bools
    scale: float
    tag_model: TagModel
    outliers: int
    suspects: list[Suspect]


def solve_scene(scene: Scene, free: Bools, *, settings: TrackSettings) -> SolvedScene:
    """All poses of a scene: first poses, the graph without outliers, the graph again with covariances.

    Args:
        scene: The sightings.
        free: Cameras whose clocks may be apart, (cameras,).
        settings: All of tracking.

    Raises:
        InputError: No camera can be placed.
        SolverError: The poses are not determined.
    """
    state = initialise(scene, settings=settings)
    known = priors(scene) | {tag_key(i): Prior(np.eye(4), None) for i in state.gauge}
    problem = Problem(scene, np.ones(len(scene.step), dtype=bool), known, settings)
    hangs = any(body.hinge is not None for body in scene.bodies)
    if problem.shares_unknowns:
        # first all poses; then moving bodies are placed again with the calibrated statics, and all solved again
        state = solve(problem, state).state
        place(scene, state, settings=settings, last_resort=True, refresh=True)
        solution = solve(problem, state)
    elif hangs:
        solution = solve(problem, state)
    else:  # the fits of the first poses are the optimum
        solution = unsolved(state, np.zeros(len(scene.cameras)))
    plain = _without_outliers(problem, free, solution)
    fit = _with_tag_model(plain, free) or plain
    used = fit.problem.used & np.isfinite(fit.errors.pixels)
    scale = fit.errors.scale(scene, used)
    problem = replace(
        fit.problem,
        used=used,
        scale=scale if abs(np.log(scale)) > np.log(COVARIANCE_SLACK) else 1.0,
        covariances=True,
        solved=hangs
        and fit.problem.timing is None
        and not problem.shares_unknowns
        and bool((used == fit.problem.used).all()),
    )
    suspects = check_set_up(scene, given(scene)) if _exceeds_noise(fit.errors, fit.problem.used) else []
    final = _fitted(problem, solve(problem, fit.solution.state))
    outliers = int(np.sum(~fit.problem.used))
    return SolvedScene(scene, final.solution, final.errors, used, scale, problem.tag_model, outliers, suspects)


@dataclass(frozen=True, eq=False)
class _Fit:
    """A problem, its solution, and the residuals of all sightings."""

    problem: Problem
    solution: Solution
    errors: ReprojectionErrors


def _fitted(problem: Problem, solution: Solution) -> _Fit:
    sigma = problem.tag_model.spread_sigma
    return _Fit(problem, solution, reproject(problem.scene, solution.state, problem.timing, spread_sigma=sigma))


def _without_outliers(problem: Problem, free: Bools, solution: Solution) -> _Fit:
    """The graph solved again without outliers, until there are none."""
    timing = _timing(problem, solution, free)
    if timing is not None:  # poses that took a step's frames for simultaneous tell no outlier
        problem = replace(problem, timing=timing)
        solution = solve(problem, solution.state)
    for _ in range(3):
        problem = replace(problem, timing=_timing(problem, solution, free))
        outlier = _outliers(problem, _fitted(problem, solution).errors)
        if not outlier.any() and problem.timing is None:
            break
        problem = replace(problem, used=problem.used & ~outlier)
        # steps that share no unknown are solved again only where a sighting was left out
        alone = problem.timing is None and not problem.shares_unknowns
        changed = np.unique(problem.scene.step[outlier]) if alone else None
        solution = solve(problem, solution.state, steps=changed)
        if not outlier.any() and not free.any():
            break
    return _fitted(problem, solution)


def _with_tag_model(plain: _Fit, free: Bools) -> _Fit | None:
    """The graph solved with the tag model that the residuals show; None where that explains little of them."""
    fit, scene = plain, plain.problem.scene
    problem = replace(plain.problem, used=np.ones_like(plain.problem.used))
    for _ in range(TAG_MODEL_PASSES):
        outlier = _outliers(problem, fit.errors)
        before, used = problem.tag_model, problem.used & ~outlier
        problem = replace(problem, used=used, tag_model=estimate_tag_model(scene, fit.errors, used, before))
        done = converged(before, problem.tag_model) and not outlier.any()
        if problem.tag_model == IDEAL_TAGS or done:
            break
        solution = solve(problem, fit.solution.state)
        problem = replace(problem, timing=_timing(problem, solution, free))
        fit = _fitted(problem, solution)
    noise, plain_noise = (one.errors.scale(scene, one.problem.used) for one in (fit, plain))
    return fit if fit is not plain and noise < NOISE_SHARE * plain_noise else None


def _exceeds_noise(errors: ReprojectionErrors, used: Bools) -> bool:
    """Whether residuals are larger than noise, or many sightings were outliers: then the set-up is checked."""
    left_out = float(np.mean(~used))
    good = used & np.isfinite(errors.whitened)
    rms = np.sqrt(np.mean(errors.whitened[good] ** 2)) if good.any() else 0.0
    return left_out > LEFT_OUT_SHARE or bool(rms > RESIDUAL_RATIO)


def _outliers(problem: Problem, errors: ReprojectionErrors) -> Bools:
    """Of each step with several tags, the one with the largest residual, if that is beyond the limit."""
    scene, used = problem.scene, problem.used
    scale = max(errors.scale(scene, used), 1e-3)
    counts = np.bincount(scene.step[used], minlength=len(scene.t))
    whitened = np.where(used, np.nan_to_num(errors.whitened, nan=np.inf), 0.0)
    whitened[~np.isfinite(errors.pixels)] = 0.0
    worst = np.zeros(len(scene.t))
    np.maximum.at(worst, scene.step, whitened)
    outlier = used & (whitened > problem.settings.outlier * scale) & (errors.pixels > OUTLIER_PIXELS)
    outlier &= counts[scene.step] > 1
    return np.asarray(outlier & (whitened >= worst[scene.step]))


def _timing(problem: Problem, solution: Solution, free: Bools) -> TimingModel | None:
    """Bodies' velocities at each step, by differences of neighbours; None where all frames are at their steps' times.

    free: (cameras,) whose clock offset is to be estimated.
    """
    scene = problem.scene
    if np.abs(scene.delay).max() < 1e-6 and not free.any():
        return None
    twists = []
    for T in solution.state.world:
        twist = np.zeros((len(T), 6))
        index = np.flatnonzero(is_known(T)) if len(T) > 1 else np.zeros(0, dtype=np.int64)
        if len(index) > 1:
            quat = matrix_to_quat(T[index, :3, :3])
            dt = np.diff(scene.t[index])
            rate = (
                np.concatenate(
                    [
                        quat_boxminus(quat[1:], quat[:-1]),
                        np.squeeze(np.swapaxes(T[index[:-1], :3, :3], 1, 2) @ np.diff(T[index, :3, 3:], axis=0), -1),
                    ],
                    axis=1,
                )
                / np.maximum(dt, 1e-9)[:, None]
            )
            rate[dt > gap(scene.t[index], problem.settings.max_gap)] = np.nan
            sides = np.stack([np.vstack([rate, rate[:1] * np.nan]), np.vstack([rate[:1] * np.nan, rate])])
            count = np.isfinite(sides).sum(axis=0)
            twist[index] = np.nansum(sides, axis=0) / np.maximum(count, 1)
        twists.append(twist)
    return TimingModel(twists, solution.clock.copy(), free)
