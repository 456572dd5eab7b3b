"""First states are found from the windows' own frames, with derivatives and covariances that are right."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.stats import t

from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.density import log_density, student_scales
from tossid.diagnosis.likelihood.engine_discrepancy import EngineDifference
from tossid.diagnosis.likelihood.innovations import costs, gauss_newton
from tossid.diagnosis.likelihood.states import difference, moved_pose
from tossid.diagnosis.likelihood.whitening import first_frames, linearise
from tossid.diagnosis.likelihood.windows import Windows, make_windows
from tossid.objects import ObjectModel
from tossid.physics.effects import Forces, RecordingErrors, World
from tossid.settings.diagnosis.likelihood import DensitySettings, LikelihoodSettings, WindowSettings


@pytest.fixture(scope="module")
def windows(cube: ObjectModel) -> Windows:
    return make_windows(seen(World(cube), cube, 6, seed=1), cube)


def test_refined_first_states_fit_the_frames_better(cube: ObjectModel, windows: Windows) -> None:
    world, free = World(cube), np.flatnonzero(windows.free)
    kept, whitening, after = linearise(windows, world, steps=6)
    before = windows.residuals(windows.predicted(world))
    np.testing.assert_array_equal(after, kept.residuals(kept.predicted(world)))
    rms = [np.sqrt((r[free] ** 2).mean(axis=(0, 1))) for r in (before, after)]
    # recorded velocities are off by 3 cm/s, which moves a flight far beyond its noise
    assert (rms[1][:3] < 0.2 * rms[0][:3]).all()
    assert np.sqrt((whitening(after)[free] ** 2).mean()) < 1.2


def test_factors_whiten_the_covariance_of_the_model(cube: ObjectModel, windows: Windows) -> None:
    """In flight, with and without slow errors: W (R + S P S^T + c c^T) W^T = 1, and W is lower triangular in time."""
    windows = windows.rows(np.flatnonzero(windows.free))
    W, K, rows = windows.slow.shape[:3]
    L = rows - 1
    rng = np.random.default_rng(0)
    alike = np.exp(-(((np.arange(rows)[:, None] - np.arange(rows)) / 8.0) ** 2))
    exists = np.concatenate([np.ones((W, 1), bool), windows.inside], axis=1)
    alike = alike * exists[:, None, :, None] * exists[:, None, None, :]
    size = np.repeat([2e-4, 4e-3], 3)[:, None, None]
    noise = np.concatenate([windows.prior[:, None, :K], windows.noise], axis=1).transpose(0, 2, 1)
    for slow in (0 * windows.slow, size**2 * alike):
        own = slow + noise[..., None] ** 2 * np.eye(rows)
        known = replace(windows, slow=slow, root=np.linalg.inv(np.linalg.cholesky(own)))
        other = 1e-3 * rng.normal(size=(W, L, K)) * known.inside[..., None]
        engine = EngineDifference(other, 0.0)
        kept, whitening, _ = linearise(known, World(cube), steps=0, difference=engine)
        basis = np.eye(K * L).reshape(K * L, 1, L, K) + whitening.mean.reshape(W, L, K)
        factor = np.stack([whitening(each).reshape(W, K * L) for each in basis], axis=2)
        # residuals are rows' own errors, less what the first pose's and velocity's errors move, and the other engine's
        S = whitening.by_state
        into = np.concatenate([-S[..., :K], S[..., K:] * kept.prior[:, None, K:], other.reshape(W, -1, 1)], axis=2)
        cov = np.zeros((W, K * L, K * L))
        for c in range(K):
            cov[:, c::K, c::K] += own[:, c, 1:, 1:]
            shared = np.zeros_like(cov)
            shared[:, :, c::K] = into[:, :, None, c] * own[:, c, None, 0, 1:]
            cov += shared + shared.mT + own[:, c, 0, 0, None, None] * into[:, :, None, c] * into[:, None, :, c]
        cov += into[..., K:] @ into[..., K:].mT
        white = factor @ cov @ factor.mT
        np.testing.assert_allclose(white, np.broadcast_to(np.eye(white.shape[1]), white.shape), atol=1e-6)
        np.testing.assert_allclose(whitening.log_det, -0.5 * np.linalg.slogdet(cov)[1], rtol=1e-9)
        assert not np.triu(factor, 1).any()


def test_poses_with_zero_covariance_are_whitened(cube: ObjectModel) -> None:
    """Simulated tosses without noise have no covariance."""
    tosses = [replace(toss, q_cov=np.zeros_like(toss.q_cov)) for toss in seen(World(cube), cube, 6, seed=1)]
    for length in (5, 40):
        settings = LikelihoodSettings(windows=WindowSettings(length=length))
        _, whitening, residuals = linearise(make_windows(tosses, cube, settings=settings), World(cube))
        assert np.isfinite(whitening(residuals)).all()


WORLDS: dict[str, dict[str, Any]] = {
    "plain": {},
    "scaled": {"recording": RecordingErrors(length_scale=1.1, clock_rate=0.9, frame_offset=(0.004, -0.003, 0.002))},
    "wind": {"forces": Forces(quadratic=0.05, wind_x=2.0, magnus=1e-3, turning=0.4)},
    "spring": {"forces": Forces(spring=0.6, center_x=0.3)},
    "vortex": {"forces": Forces(vortex=0.6)},
    "tilt": {"ground_tilt": (0.05, -0.1)},
    "tilted frame": {"recording": RecordingErrors(world_tilt=(0.05, -0.1))},
}


@pytest.mark.parametrize("name", WORLDS)
def test_derivatives_by_the_first_position_are_those_of_a_shifted_motion(cube: ObjectModel, name: str) -> None:
    world, step = World(cube, **WORLDS[name]), 2e-4
    windows = make_windows(seen(world, cube, 8, seed=1))
    _, whitening, _ = linearise(windows, world, steps=0)
    for k in range(2):
        moved = windows.q + step * np.eye(7)[k]
        change = windows.residuals(windows.predicted(world)) - windows.residuals(
            windows.predicted(world, moved, windows.v)
        )
        error = np.abs(whitening.by_state[..., k] - change.reshape(len(change), -1) / step).max(axis=1)
        # where a contact has more than one solution to its tolerance, differences have that error
        assert np.median(error) < 1e-9
        assert np.quantile(error, 0.9) < 1e-3


def with_contact(cube: ObjectModel, count: int, seed: int) -> Windows:
    windows = make_windows(seen(World(cube), cube, count, seed=seed, frames=70), cube)
    return windows.rows(np.flatnonzero(~windows.steady))


def test_only_first_frames_are_left(cube: ObjectModel) -> None:
    windows = with_contact(cube, 6, 2)
    part = first_frames(windows, 0.4)
    before = windows.inside.sum(1)
    np.testing.assert_array_equal(part.inside.sum(1), np.ceil(0.4 * before))
    np.testing.assert_array_equal(part.steps, part.inside.sum(1))
    residuals = part.residuals(part.predicted(World(cube)))
    assert (residuals[~part.inside] == 0.0).all()
    whole = windows.residuals(windows.predicted(World(cube)))
    np.testing.assert_allclose(residuals[part.inside], whole[part.inside], atol=1e-12)


def test_a_restart_follows_first_states_from_first_frames(cube: ObjectModel) -> None:
    """Recorded velocities are far off; over all frames at once, most fits end in other impacts than those seen."""
    world, noise = World(cube), np.random.default_rng(0)
    count, poor = 0, np.zeros(2, dtype=int)
    for seed in (3, 4):
        windows = with_contact(cube, 12, seed)
        off = noise.normal(size=windows.v.shape) * np.array([0.15] * 3 + [2.0] * 3)
        lost = replace(windows, v=windows.v + off, at_v=windows.v + off)
        count += len(windows.q)
        for restarts in (0, 1):
            kept, whitening, residuals = linearise(lost, world, steps=6, restarts=restarts)
            n = 6 * kept.inside.sum(1)
            poor[restarts] += ((whitening(residuals) ** 2).sum((1, 2)) > n + 3 * np.sqrt(2 * n)).sum()
    at_once, followed = poor
    assert at_once > 0.07 * count
    assert followed < 0.4 * at_once


# ---------------------------------------------------------------- the kernels of first states, by dense matrices


Array = NDArray[np.float64]

W, K, L = 4, 6, 5


class Case(NamedTuple):
    """Windows with correlated errors of each channel, and a difference to another engine."""

    chosen: NDArray[np.int64]
    residuals: Array
    other: Array
    root: Array
    by_state: Array
    deviation: Array
    prior: Array

    def dense(self, b: int) -> tuple[Array, Array, Array]:
        """Derivatives (K (L + 1), 2 K), residuals and the other engine's difference, whitened by all own errors."""
        w = self.chosen[b]
        columns, r, o = [], [], []
        for c in range(K):
            first = np.eye(K, 2 * K)[c]
            S = np.concatenate([first[None], self.by_state[w].reshape(L, K, 2 * K)[:, c]])
            columns.append(self.root[w, c] @ S)
            r.append(self.root[w, c] @ np.append(self.deviation[b, c], self.residuals[b].reshape(L, K)[:, c]))
            o.append(self.root[w, c] @ np.append(0.0, self.other[w].reshape(L, K)[:, c]))
        return np.concatenate(columns), np.concatenate(r), np.concatenate(o)


@pytest.fixture
def case() -> Case:
    rng = np.random.default_rng(0)
    chosen = np.array([3, 0, 2])
    root = np.tril(rng.normal(size=(W, K, L + 1, L + 1))) + 3 * np.eye(L + 1)
    return Case(
        chosen,
        rng.normal(size=(3, K * L)),
        rng.normal(size=(W, K * L)),
        root,
        rng.normal(size=(W, K * L, 2 * K)),
        rng.normal(size=(3, 2 * K)),
        rng.uniform(0.5, 2.0, (W, 2 * K)),
    )


@pytest.mark.parametrize("center", [0.0, 1.0])
def test_costs_have_the_best_multiple_of_the_other_engine(case: Case, center: float) -> None:
    found = np.empty(3)
    costs(case.chosen, case.residuals, center, case.other, case.root, case.deviation, case.prior, found)
    for b in range(3):
        _, r, o = case.dense(b)
        r = r - center * o
        # the multiple is a parameter of standard deviation 1, over which the cost is least
        best = (o @ r) / (1 + o @ o)
        expected = ((r - best * o) ** 2).sum() + best**2
        speeds = case.deviation[b, K:] / case.prior[case.chosen[b], K:]
        assert found[b] == pytest.approx(expected + (speeds**2).sum())


@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_steps_solve_the_normal_equations(case: Case, damping: float) -> None:
    found = np.empty((3, 2 * K))
    gauss_newton(
        case.chosen, case.residuals, 1.0, case.other, case.root, case.by_state, case.deviation, case.prior,
        np.full(3, damping), found,
    )  # fmt: skip
    for b in range(3):
        columns, r, o = case.dense(b)
        J = np.concatenate([columns, o[:, None]], axis=1)
        weight = np.concatenate([np.zeros(K), case.prior[case.chosen[b], K:] ** -2, [1.0]])
        H, g = J.T @ J + np.diag(weight), J.T @ (r - o)
        g[K:-1] += case.deviation[b, K:] * weight[K:-1]
        H += damping * np.diag(np.diag(H))
        np.testing.assert_allclose(found[b], np.linalg.solve(H, g)[:-1], rtol=1e-9, atol=1e-12)


# ---------------------------------------------------------------- Student's density, and differences of states


NU = DensitySettings().degrees_of_freedom


def test_a_scale_maximises_the_likelihood_of_its_group() -> None:
    rng = np.random.default_rng(0)
    group = rng.integers(-1, 3, size=(40, 8))
    residuals = np.array([3.0, 7.0, 20.0, 1e6])[group][..., None] * rng.standard_t(NU, size=(40, 8, 6))
    found = student_scales(residuals, group, 5, DensitySettings())
    for g in range(3):
        own = residuals[group == g].ravel()
        best = minimize_scalar(lambda s, own=own: -t.logpdf(own / s, NU).sum() + own.size * np.log(s), bounds=(0.1, 99))
        assert found[g] == pytest.approx(best.x, rel=1e-4)
    np.testing.assert_array_equal(found[3:], 1.0)
    nothing = np.zeros((2, 3, 6))
    assert (student_scales(nothing, np.zeros((2, 3), int), 1, DensitySettings()) == 1.0).all()


def test_log_densities_are_students_but_for_a_constant_an_entry() -> None:
    rng = np.random.default_rng(1)
    residuals, scale = (
        rng.normal(size=(5, 4, 6)) * 10.0 ** rng.integers(-3, 4, size=(5, 4, 6)),
        rng.uniform(1, 9, (5, 4)),
    )
    inside = rng.random((5, 4)) < 0.7
    out = log_density(residuals, inside, scale)
    constant = t.logpdf(0.0, NU)
    plain = t.logpdf(residuals / scale[..., None], NU) - constant - np.log(scale)[..., None]
    np.testing.assert_allclose(out, np.where(inside[..., None], plain, 0.0).sum((1, 2)), rtol=1e-12)


def test_a_moved_pose_differs_by_what_it_was_moved_by() -> None:
    rng = np.random.default_rng(0)
    q, by = rng.normal(size=(50, 7 + 1)), 0.5 * rng.normal(size=(50, 7))
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    np.testing.assert_allclose(difference(moved_pose(q, by), q), by, atol=1e-12)
