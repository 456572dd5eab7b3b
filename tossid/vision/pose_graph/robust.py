"""The poses of a scene by the graph, robustly: outliers left out, clocks refined, tags modelled, the set-up checked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.rotations import matrix_to_quat, quat_boxminus
from tossid.settings.tracking import TrackSettings
from tossid.vision.pose_graph.factors import IDEAL_TAGS, TagModel
from tossid.vision.pose_graph.graph import solve
from tossid.vision.pose_graph.initial import initialise, place
from tossid.vision.pose_graph.reprojection import ReprojectionErrors, reproject
from tossid.vision.pose_graph.scene import Scene, gap
from tossid.vision.pose_graph.setup_checks import Suspect, check_set_up
from tossid.vision.pose_graph.state import (
    Prior,
    Solution,
    TimingModel,
    calibrates,
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

    def clocks(self, offsets: dict[int, float]) -> dict[int, tuple[float, float]]:
        """Offsets of clocks with standard deviations [s], by camera's number.

        Args:
            offsets: Those subtracted before the graph, to which it adds [s].
        """
        found, sigma = self.solution.clock, self.solution.clock_sigma
        return {c: (offset + float(found[c]), float(sigma[c])) for c, offset in offsets.items()}


def solve_scene(scene: Scene, offsets: dict[int, float], *, settings: TrackSettings) -> SolvedScene:
    """All poses of a scene: first poses, the graph without outliers, the graph again with covariances.

    Args:
        scene: The sightings, with `offsets` subtracted from their times.
        offsets: Of clocks that are apart [s], by camera's number; the graph refines these.
        settings: All of tracking.

    Raises:
        InputError: No camera can be placed.
        SolverError: The poses are not determined.
    """
    state = initialise(scene, settings=settings)
    known = priors(scene) | {tag_key(i): Prior(np.eye(4), None) for i in state.gauge}
    used = np.ones(len(scene.step), dtype=bool)
    hangs = any(body.hinge is not None for body in scene.bodies)
    if calibrates(scene, known):
        # first all poses; then moving bodies are placed again with the calibrated statics, and all solved again
        state = solve(scene, state, used, known=known, settings=settings).state
        place(scene, state, settings=settings, last_resort=True, refresh=True)
        solution = solve(scene, state, used, known=known, settings=settings)
    elif hangs:
        solution = solve(scene, state, used, known=known, settings=settings)
    else:  # the fits of the first poses are the optimum
        solution = unsolved(state, np.zeros(len(scene.cameras)))
    free = np.isin(np.arange(len(scene.cameras)), list(offsets))
    plain = _without_outliers(scene, known, settings, free, solution)
    fit = _with_tag_model(scene, known, settings, free, plain) or plain
    doubtful = _exceeds_noise(fit.errors, fit.used)
    suspects = check_set_up(scene, given(scene)) if doubtful else []
    used = fit.used & np.isfinite(fit.errors.pixels)
    scale = fit.errors.scale(scene, used)
    covariance_scale = scale if abs(np.log(scale)) > np.log(COVARIANCE_SLACK) else 1.0
    alone = fit.timing is None and not calibrates(scene, known)
    solution = solve(
        scene,
        fit.solution.state,
        used,
        scale=covariance_scale,
        known=known,
        timing=fit.timing,
        tag_model=fit.tag_model,
        covariances=True,
        solved=hangs and alone and bool((used == fit.used).all()),
        settings=settings,
    )
    errors = reproject(scene, solution.state, fit.timing, spread_sigma=fit.tag_model.spread_sigma)
    return SolvedScene(scene, solution, errors, used, scale, fit.tag_model, int(np.sum(~fit.used)), suspects)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Poses, the sightings (d,) that they rest on, bodies' motion within steps, residuals, and the tag model."""

    solution: Solution
    used: Bools
    timing: TimingModel | None
    errors: ReprojectionErrors
    tag_model: TagModel


def _without_outliers(
    scene: Scene, known: dict[int, Prior], settings: TrackSettings, free: Bools, solution: Solution
) -> _Fit:
    """The graph solved again without outliers, until there are none."""
    used, timing = np.ones(len(scene.step), dtype=bool), _timing(scene, solution, settings, free)
    if timing is not None:  # poses that took a step's frames for simultaneous tell no outlier
        solution = solve(scene, solution.state, used, known=known, timing=timing, settings=settings)
    for _ in range(3):
        timing = _timing(scene, solution, settings, free)
        outlier = _outliers(scene, reproject(scene, solution.state, timing), used, settings)
        if not outlier.any() and timing is None:
            break
        used &= ~outlier
        # steps that share no unknown are solved again only where a sighting was left out
        alone = timing is None and not calibrates(scene, known)
        changed = np.unique(scene.step[outlier]) if alone else None
        solution = solve(scene, solution.state, used, known=known, timing=timing, steps=changed, settings=settings)
        if not outlier.any() and not free.any():
            break
    return _Fit(solution, used, timing, reproject(scene, solution.state, timing), IDEAL_TAGS)


def _with_tag_model(
    scene: Scene, known: dict[int, Prior], settings: TrackSettings, free: Bools, plain: _Fit
) -> _Fit | None:
    """The graph solved with the tag model that the residuals show; None where that explains little of them."""
    tag_model, errors, fit = IDEAL_TAGS, plain.errors, plain
    used = np.ones(len(scene.step), dtype=bool)
    for _ in range(TAG_MODEL_PASSES):
        outlier = _outliers(scene, errors, used, settings)
        used = used & ~outlier
        before = tag_model
        tag_model = estimate_tag_model(scene, errors, used, before)
        done = converged(before, tag_model) and not outlier.any()
        if tag_model == IDEAL_TAGS or done:
            break
        solution = solve(
            scene, fit.solution.state, used, known=known, timing=fit.timing, tag_model=tag_model, settings=settings
        )
        timing = _timing(scene, solution, settings, free)
        errors = reproject(scene, solution.state, timing, spread_sigma=tag_model.spread_sigma)
        fit = _Fit(solution, used, timing, errors, tag_model)
    explained = fit.errors.scale(scene, fit.used) < NOISE_SHARE * plain.errors.scale(scene, plain.used)
    return fit if fit is not plain and explained else None


def _exceeds_noise(errors: ReprojectionErrors, used: Bools) -> bool:
    """Whether residuals are larger than noise, or many sightings were outliers: then the set-up is checked."""
    left_out = float(np.mean(~used))
    good = used & np.isfinite(errors.whitened)
    rms = np.sqrt(np.mean(errors.whitened[good] ** 2)) if good.any() else 0.0
    return left_out > LEFT_OUT_SHARE or bool(rms > RESIDUAL_RATIO)


def _outliers(scene: Scene, errors: ReprojectionErrors, used: Bools, settings: TrackSettings) -> Bools:
    """Of each step with several tags, the one with the largest residual, if that is beyond the limit."""
    scale = max(errors.scale(scene, used), 1e-3)
    counts = np.bincount(scene.step[used], minlength=len(scene.t))
    whitened = np.where(used, np.nan_to_num(errors.whitened, nan=np.inf), 0.0)
    whitened[~np.isfinite(errors.pixels)] = 0.0
    worst = np.zeros(len(scene.t))
    np.maximum.at(worst, scene.step, whitened)
    outlier = used & (whitened > settings.outlier * scale) & (errors.pixels > OUTLIER_PIXELS)
    outlier &= counts[scene.step] > 1
    return np.asarray(outlier & (whitened >= worst[scene.step]))


def _timing(scene: Scene, solution: Solution, settings: TrackSettings, free: Bools) -> TimingModel | None:
    """Bodies' velocities at each step, by differences of neighbours; None where all frames are at their steps' times.

    free: (cameras,) whose clock offset is to be estimated.
    """
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
            rate[dt > gap(scene.t[index], settings.max_gap)] = np.nan
            sides = np.stack([np.vstack([rate, rate[:1] * np.nan]), np.vstack([rate[:1] * np.nan, rate])])
            count = np.isfinite(sides).sum(axis=0)
            twist[index] = np.nansum(sides, axis=0) / np.maximum(count, 1)
        twists.append(twist)
    return TimingModel(twists, solution.clock.copy(), free)
