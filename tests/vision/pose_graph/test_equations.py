"""The graph's equations: corners and their residuals with derivatives, the robust loss, least squares, covariances."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
import pytest

from tests.vision.sights import filmed_tumble, motion, seen, wall
from tossid.errors import SolverError
from tossid.objects import ObjectModel
from tossid.rotations import quat_normalize, transform, transform_inv, transform_points
from tossid.vision.cameras.rig import default_rig
from tossid.vision.pose_graph.batch import Batch, Point
from tossid.vision.pose_graph.corner_projection import contradictions, corner_residuals
from tossid.vision.pose_graph.initial import initialise
from tossid.vision.pose_graph.least_squares import (
    WEAK_PRIOR,
    Normal,
    SingularError,
    covariances,
    eliminate,
    normal_equations,
    optimise,
)
from tossid.vision.pose_graph.reprojection import Chain
from tossid.vision.pose_graph.resect import BEHIND, Sightings, retract, tag_poses
from tossid.vision.pose_graph.residuals import Rows, TagModel, between_residuals, sighting_residuals
from tossid.vision.pose_graph.scene import observe
from tossid.vision.pose_graph.state import TimingModel, priors
from tossid.vision.pose_graph.unknowns import Problem
from tossid.vision.setup.faces import default_tags
from tossid.vision.setup.layout import SQUARE, Body, Measurement, TagLayout, articulated, layout_of


def sightings(rng: np.random.Generator, n: int, m: int, sigma: float) -> tuple[Sightings, np.ndarray]:
    """m tags on each of n targets before cameras 1.5 m away; the true T_parent_target."""
    T = transform(rng.uniform(-0.1, 0.1, (n, 3)), quat_normalize(rng.normal(size=(n, 4))))
    T_parent_cam = np.eye(4)
    T_parent_cam[:3, 3] = [0.0, 0.0, -1.5]
    group = np.repeat(np.arange(n), m)
    T_cam_parent = np.broadcast_to(transform_inv(T_parent_cam), (n * m, 4, 4)).copy()
    facing = transform(
        rng.uniform(-0.05, 0.05, (n * m, 3)), quat_normalize([0.0, 1.0, 0.0, 0.0] + rng.normal(size=(n * m, 4)) / 4)
    )
    T_target_tag = transform_inv(T[group]) @ facing
    half = np.full(n * m, 0.04)
    x = transform_points(T_cam_parent @ T[group] @ T_target_tag, half[:, None, None] * SQUARE)
    seen = x[..., :2] / x[..., 2:] + sigma * rng.normal(size=(n * m, 4, 2))
    whiten = np.broadcast_to(np.eye(2) / sigma, (n * m, 4, 2, 2))
    return Sightings(group, T_cam_parent, T_target_tag, half, seen, whiten, tag_poses(seen, half)), T


def test_residuals_and_their_derivatives_are_those_of_the_pinhole() -> None:
    s, T = sightings(np.random.default_rng(0), 3, 2, 1e-4)
    T = s.T_cam_parent @ T[s.group]
    x = transform_points(T, s.points)
    r, J = corner_residuals(T, s.points, s.seen, s.whiten)
    expected = np.squeeze(s.whiten @ (x[..., :2] / x[..., 2:] - s.seen)[..., None], -1)
    np.testing.assert_allclose(r, expected, atol=1e-9)
    for k, e in enumerate(1e-6 * np.eye(6)):
        up, down = (
            corner_residuals(retract(T, np.tile(step, (len(T), 1))), s.points, s.seen, s.whiten)[0] for step in (e, -e)
        )
        np.testing.assert_allclose(J[..., k], (up - down) / 2e-6, rtol=1e-4, atol=1e-4 * np.abs(J).max())


def test_a_tag_behind_the_lens_has_no_residual() -> None:
    s, T = sightings(np.random.default_rng(5), 2, 2, 1e-3)
    T[1, 2, 3] -= 100.0
    r, J, size = s.errors(T[s.group])
    behind = s.group == 1
    assert np.isnan(corner_residuals(s.T_cam_parent @ T[s.group], s.points, s.seen, s.whiten)[0][behind]).all()
    assert (size[behind] == BEHIND).all()
    assert not r[behind].any()
    assert not J[behind].any()
    np.testing.assert_allclose(size[~behind], np.linalg.norm(r[~behind].reshape(-1, 4, 2), axis=2))
    assert (size[~behind] < BEHIND).all()


def test_contradictions_are_geman_and_mcclures_loss() -> None:
    rng = np.random.default_rng(6)
    s, T = sightings(rng, 3, 2, 1e-3)
    candidates = np.concatenate([retract(T, 0.02 * rng.normal(size=(3, 6))), np.full((1, 4, 4), np.nan), T])
    candidates[4, 2, 3] -= 100.0  # behind the lens
    of, by = np.arange(7).repeat(6), np.tile(np.arange(6), 7)
    tolerance = rng.uniform(0.002, 0.01, 6)
    found = contradictions(candidates, of, by, s.T_cam_parent, s.points, s.seen, tolerance)
    plain = np.tile(np.eye(2), (len(by), 4, 1, 1))
    errors = corner_residuals(s.T_cam_parent[by] @ candidates[of], s.points[by], s.seen[by], plain)[0]
    square = np.sum(errors**2, axis=-1)
    square /= tolerance[by, None] ** 2
    loss = np.nan_to_num(square / (1 + square), nan=1.0).sum(axis=1).reshape(7, 6).sum(axis=1)
    assert found[3] == np.inf
    assert found[4] == 24
    usable = [0, 1, 2, 4, 5, 6]
    np.testing.assert_allclose(found[usable], loss[usable], rtol=1e-9)


# ---------------------------------------------------------------- derivatives


def _gradient(batch: Batch, point: Point) -> tuple[np.ndarray, np.ndarray]:
    """The gradient of a batch's error by all unknowns, and that by differences."""
    normal, columns = batch.normal(point), batch.columns
    found, numerical = np.concatenate([normal.g_s, normal.g_k.reshape(-1)]), []
    for e in 1e-6 * np.eye(len(found)):
        moved = (
            batch.moved(point, step[: columns.shared], step[columns.shared :].reshape(-1, columns.own))
            for step in (e, -e)
        )
        ends = [batch.error(there).sum() for there in moved]
        numerical.append((ends[0] - ends[1]) / 2e-6)
    return found, np.array(numerical)


def _batch(scene_of: tuple, rng: np.random.Generator, *, spread: float = 0.0, statics: bool = True) -> Batch:
    """Three steps of a scene whose clocks, prints and static poses are unknown, at a point beside the first poses."""
    detections, cameras, layout = scene_of
    scene = observe(detections, cameras, layout, dropped=Counter())
    state = initialise(scene)
    timing = TimingModel.none(scene)
    twist = [0.5 * rng.normal(size=(len(T), 6)) for T in state.world]
    timing = replace(timing, twist=twist, free=np.ones(len(cameras), dtype=bool))
    tags = TagModel(spread, frozenset(range(len(scene.tags))))
    problem = Problem(scene, np.ones(len(scene.step), dtype=bool), priors(scene), timing=timing, tag_model=tags)
    return Batch(problem, state, np.arange(3), statics=statics)


def _beside(batch: Batch, rng: np.random.Generator, size: float) -> Point:
    columns = batch.columns
    steps = size * rng.normal(size=columns.shared), size * rng.normal(size=(3, columns.own))
    return batch.moved(batch.start, *steps)


@pytest.mark.parametrize(("size", "spread"), [(1e-5, 0.0), (3e-3, 0.0), (1e-5, 2.0)], ids=["near", "robust", "spread"])
def test_derivatives_by_every_pose_a_print_and_a_clock(tagged: ObjectModel, size: float, spread: float) -> None:
    """Cameras of unknown pose, one of which wiggles, tags of unknown pose, stillness; within Huber's threshold and
    beyond, and where edges spread."""
    rng, cameras = np.random.default_rng(0), default_rig()
    detections, _ = filmed_tumble(cameras, tagged, rng, n=3)
    layout = layout_of(tagged)
    vague = {"position_noise": np.full(3, 0.01), "rotation_noise": np.full(3, 0.1)}
    tags = tuple(replace(tag, **vague) for tag in layout.bodies[-1].tags)
    still = replace(layout.bodies[-1], tags=tags, stillness=(0.05, 0.5))
    unknown = [cameras[0], *(replace(one, T_rig_cam_cov=1e-4 * np.eye(6)) for one in cameras[1:])]
    unknown[1] = replace(unknown[1], wiggle=(0.002, 0.001))
    batch = _batch((detections, unknown, replace(layout, bodies=(*layout.bodies[:-1], still))), rng, spread=spread)
    columns = batch.columns
    assert min(columns.camera[1], columns.mount[1], columns.clock[1]) >= 0
    assert np.array_equal(columns.tag >= 0, columns.print >= 0)
    assert (columns.tag >= 0).sum() >= 4
    found, numerical = _gradient(batch, _beside(batch, rng, size))
    np.testing.assert_allclose(found, numerical, rtol=1e-4, atol=1e-5 * np.abs(found).max())


def test_derivatives_by_hinges_and_roots(elbow: ObjectModel) -> None:
    model = elbow.with_changes(tags=default_tags(elbow))
    rng, cameras = np.random.default_rng(1), default_rig()
    q = np.concatenate([motion(3, rng), rng.uniform(-1, 1, (3, 1))], axis=1)
    detections = [d for i in range(3) for d in seen(cameras, model, i / 148, q[i], rng, 0.1)]
    batch = _batch((detections, cameras, articulated(layout_of(model), model)), rng)
    assert batch.columns.angle.max() >= 0
    found, numerical = _gradient(batch, _beside(batch, rng, 1e-4))
    np.testing.assert_allclose(found, numerical, rtol=1e-4, atol=1e-5 * np.abs(found).max())


def test_derivatives_of_measured_lengths() -> None:
    rng = np.random.default_rng(2)
    detections, cameras, layout = wall(rng, noise=0.1)
    lengths = (
        Measurement("distance", ((0, 0), (3, 3)), 0.5, 0.01),
        Measurement("coordinate", ((1, 2),), 0.5, 0.01, np.array([0, 0.6, 0.8])),
    )
    batch = _batch((detections, cameras, replace(layout, measurements=lengths)), rng)
    found, numerical = _gradient(batch, _beside(batch, rng, 1e-4))
    np.testing.assert_allclose(found, numerical, rtol=1e-4, atol=1e-5 * np.abs(found).max())


def test_the_derivatives_between_two_poses() -> None:
    rng, sigma = np.random.default_rng(3), np.array([0.1, 0.2, 0.3, 1.0, 2.0, 3.0])
    A, B = (transform(rng.normal(size=(1, 3)), quat_normalize(rng.normal(size=(1, 4)))) for _ in range(2))
    _, J_a, J_b = between_residuals(A, B, sigma)
    for k, e in enumerate(1e-6 * np.eye(6)):
        by_a = [between_residuals(retract(A, step[None]), B, sigma)[0] for step in (e, -e)]
        by_b = [between_residuals(A, retract(B, step[None]), sigma)[0] for step in (e, -e)]
        for J, ends in ((J_a, by_a), (J_b, by_b)):
            np.testing.assert_allclose(J[0, :, k], (ends[0] - ends[1])[0] / 2e-6, atol=1e-6)


def test_the_loss_is_hubers() -> None:
    """A camera before one tag, 0.1 off in units of 0.01; and a tag behind the lens."""
    detections, cameras, layout = wall(np.random.default_rng(4))
    lab = Body("lab", True, np.eye(4), tags=(layout.bodies[0].tags[0],))
    scene = observe(detections[:1], cameras, TagLayout((lab, Body("rig", True, np.eye(4)))), dropped=Counter())
    at = transform(np.array([0.0, 0, 1.0]), np.array([1.0, 0, 0, 0]))[None]
    half = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]]) * scene.half[0]
    scene = replace(scene, seen=half[None] + [0.1, 0.0], whiten=np.tile(100.0 * np.eye(2), (1, 4, 1, 1)))

    def error(T_body_tag: np.ndarray) -> float:
        chain, still = Chain(*[np.eye(4)[None]] * 4, T_body_tag), np.zeros((1, 6))
        found = sighting_residuals(scene, chain, np.zeros((1, 3)), rates=(still, still), scale=1.0, spread_sigma=0.0)
        return 0.5 * float(np.sum(found.r**2))

    assert error(at) == pytest.approx(4 * (3 * 10.0 - 4.5))
    behind = at.copy()
    behind[0, 2, 3] = -1.0
    assert np.isfinite(error(behind))
    assert error(behind) > 1e5


# ---------------------------------------------------------------- least squares

SHARED, N, OWN = 3, 4, 2


def _system(rng: np.random.Generator, *, chained: bool) -> tuple[Normal, np.ndarray, np.ndarray]:
    """Normal equations of random residuals, and the whole Hessian and gradient."""
    column = np.array([[0, 1, 2, 3, 4], [0, 1, -1, 3, 4], [2, 1, 0, 4, 3], [1, 2, -1, -1, 4]])
    rows = [Rows(rng.normal(size=(N, 6)), rng.normal(size=(N, 6, 5)), column, rng.permutation(N)) for _ in range(3)] + [
        Rows(rng.normal(size=(1, 6)), rng.normal(size=(1, 6, 3)), np.arange(3)[None], np.zeros(1, dtype=int))
    ]
    normal = normal_equations(rows, SHARED, N, OWN)
    H, g = np.zeros((SHARED + N * OWN,) * 2), np.zeros(SHARED + N * OWN)
    for r, J, columns, step in rows:
        for d in range(len(r)):
            at = np.where(columns[d] < SHARED, columns[d], columns[d] + OWN * step[d])[columns[d] >= 0]
            own = J[d][:, columns[d] >= 0]
            H[np.ix_(at, at)] += own.T @ own
            g[at] += own.T @ r[d]
    if chained:
        normal = replace(normal, H_next=0.2 * rng.normal(size=(N - 1, OWN, OWN)))
        assert normal.H_next is not None
        for k, block in enumerate(normal.H_next):
            a, b = (SHARED + OWN * i + np.arange(OWN) for i in (k, k + 1))
            H[np.ix_(a, b)] += block
            H[np.ix_(b, a)] += block.T
    return normal, H, g


@pytest.mark.parametrize("chained", [False, True])
def test_the_step_and_the_covariances_are_those_of_the_whole_hessian(chained: bool) -> None:
    normal, H, g = _system(np.random.default_rng(0), chained=chained)
    found, inverse = eliminate(normal, damping=0.2), np.linalg.inv(H + 0.2 * np.eye(len(H)))
    step = np.concatenate([found.step_s, found.step_k.reshape(-1)])
    np.testing.assert_allclose(step, -inverse @ g, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(found.cov_s, inverse[:SHARED, :SHARED], rtol=1e-8, atol=1e-12)
    for k in range(N):
        own = slice(SHARED + OWN * k, SHARED + OWN * (k + 1))
        np.testing.assert_allclose(found.cov_k[k], inverse[own, own], rtol=1e-8, atol=1e-12)


def test_what_nothing_depends_on_stays() -> None:
    normal, _, _ = _system(np.random.default_rng(1), chained=False)
    assert normal.used.all()
    alone = normal_equations([Rows(np.ones((1, 1)), np.ones((1, 1, 1)), np.array([[0]]), np.array([0]))], 0, 2, 3)
    found = eliminate(alone)
    assert not alone.used[1].any()
    np.testing.assert_array_equal(found.step_k[1], 0.0)


def test_what_nothing_determines_is_named() -> None:
    J = np.array([[[1.0, 0.0, 2.0]]])
    with pytest.raises(SingularError) as caught:
        eliminate(normal_equations([Rows(np.ones((1, 1)), J, np.array([[0, 1, 2]]), np.array([0]))], 1, 1, 2))
    assert caught.value.column == 1


@dataclass(frozen=True)
class _OfOneNumber:
    """A sum of squares of one number's residuals: each r(x) and dr/dx."""

    residuals: tuple

    def error(self, x: float) -> np.ndarray:
        return np.array([0.5 * sum(residual(x)[0] ** 2 for residual in self.residuals)])

    def normal(self, x: float) -> Normal:
        r, slope = (np.array(values) for values in zip(*(residual(x) for residual in self.residuals), strict=True))
        return normal_equations([Rows(r[None], slope[None, :, None], np.zeros((1, 1), int), np.zeros(1, int))], 1, 0, 0)

    def moved(self, x: float, step_s: np.ndarray, step_k: np.ndarray) -> float:
        return x + float(step_s[0])


def test_two_priors_meet_at_their_weighted_mean() -> None:
    problem = _OfOneNumber((lambda x: (x - 1.0, 1.0), lambda x: ((x - 4.0) / 0.5, 2.0)))
    x = optimise(problem, 10.0)
    assert x == pytest.approx((1.0 + 4 * 4.0) / 5)
    assert covariances(problem.normal(x)).cov_s[0, 0] == pytest.approx(1 / 5)


def test_damping_holds_a_step_that_would_diverge() -> None:
    """Newton's method on atan(x) diverges from |x| > 1.39."""
    assert optimise(_OfOneNumber((lambda x: (np.arctan(x), 1 / (1 + x * x)),)), 3.0) == pytest.approx(0.0, abs=1e-4)


@dataclass(frozen=True)
class _OfEachStep:
    """Steps that share nothing, each with the residual atan(x - root)."""

    root: np.ndarray

    def error(self, x: np.ndarray) -> np.ndarray:
        return 0.5 * np.arctan(x - self.root) ** 2

    def normal(self, x: np.ndarray) -> Normal:
        n, apart = len(x), x - self.root
        slope = (1 / (1 + apart**2))[:, None, None]
        return normal_equations([Rows(np.arctan(apart)[:, None], slope, np.zeros((n, 1), int), np.arange(n))], 0, n, 1)

    def moved(self, x: np.ndarray, step_s: np.ndarray, step_k: np.ndarray) -> np.ndarray:
        return x + step_k[:, 0]


def test_steps_that_share_nothing_are_damped_alone() -> None:
    """Undamped steps end at once near the root, and diverge from far: neither spoils the other."""
    problem = _OfEachStep(np.array([1.0, -2.0, 5.0]))
    np.testing.assert_allclose(optimise(problem, np.array([1.1, 3.0, 2.0])), problem.root, atol=1e-4)


def test_an_error_that_is_never_finite_is_refused() -> None:
    with pytest.raises(SolverError, match="no finite error"):
        optimise(_OfOneNumber((lambda x: (np.nan, 1.0),)), 0.0)


def test_what_nothing_determines_has_the_weak_priors_covariance() -> None:
    found = covariances(_OfOneNumber((lambda x: (0.0, 0.0),)).normal(0.0))
    assert found.cov_s[0, 0] == pytest.approx(WEAK_PRIOR**2)
