"""Intervals of what rollouts taught: they cover the truth, and say what the tosses leave open."""

from __future__ import annotations

import numpy as np
import pytest

from tests.models.made import tosses
from tossid.models.contactnets import ContactNets
from tossid.objects import ObjectModel
from tossid.settings.training import ModelSettings
from tossid.training.fit import Fit
from tossid.training.prediction import GaussNewton
from tossid.training.uncertainty import OPEN_LAW, covariance, parameter_intervals, quantities
from tossid.types import Toss

FRICTION = ModelSettings(learn_geometry=False, implicit=False, substeps=ModelSettings.substeps)


def noisy(made: list[Toss], *, seed: int) -> list[Toss]:
    """The tosses with first velocities off by 2 cm/s and 0.1 rad/s."""
    rng = np.random.default_rng(seed)
    return [
        Toss(t.name, t.t, t.q, t.v + rng.normal(size=6) * [0.02, 0.02, 0.02, 0.1, 0.1, 0.1], t.q_cov, t.v_cov, t.phase)
        for t in made
    ]


def fit_of(cube: ObjectModel, settings: ModelSettings, count: int, *, seed: int, train: int) -> Fit:
    made = noisy(tosses(cube, count, seed=seed, substeps=settings.substeps), seed=seed)
    return Fit(ContactNets(cube, settings), made[:train], made[train:])


class Given:
    """A stage whose sums are given, and whose losses prefer Coulomb's law or its relaxation."""

    def __init__(self, sums: GaussNewton, away: np.ndarray, *, relaxed_losses: np.ndarray | None = None) -> None:
        self.sums, self.away, self.x = sums, away, sums.x
        self._relaxed_losses, self._losses = relaxed_losses, np.ones(len(sums.g))

    def with_relaxed_contact(self) -> Given | None:
        if self._relaxed_losses is None:
            return None
        H = self.sums.H
        other = Given(self.sums._replace(g=-H @ self.away), self.away)
        other._losses = self._relaxed_losses
        return other

    def training_losses(self) -> np.ndarray:
        return self._losses

    def gauss_newton(self) -> GaussNewton:
        return self.sums

    def set_parameters(self, x: np.ndarray) -> None:
        self.x = x


def sums_of(H: np.ndarray, g: np.ndarray) -> GaussNewton:
    return GaussNewton(H, g, np.zeros(g.shape[1]), np.zeros((1, 1), dtype=bool))


@pytest.mark.parametrize("n", [5, 40])
def test_of_a_line_the_covariance_is_that_of_least_squares(n: int) -> None:
    """Over 400 sets of values about a line, each of which is a toss: no narrower than the scatter of their fits."""
    rng = np.random.default_rng(n)
    X = np.stack([np.ones(n), np.linspace(-1, 1, n)], axis=1)
    H, found, said = X[:, :, None] * X[:, None, :], [], []
    for _ in range(400):
        y = rng.normal(size=n)
        at = np.linalg.lstsq(X, y, rcond=None)[0]
        sums = sums_of(H, X * (X @ at - y)[:, None])
        found.append(at)
        said.append(covariance(Given(sums, np.zeros(2)), sums)[0])  # type: ignore[arg-type]
    ratio = np.diag(np.mean(said, axis=0)) / np.var(found, axis=0)
    assert (ratio > 0.85).all()
    assert (ratio < 1.1 + 4 / n).all()


def test_a_law_that_tosses_do_not_reject_widens_and_one_that_they_reject_does_not() -> None:
    rng = np.random.default_rng(1)
    H, g = np.tile(np.eye(2), (8, 1, 1)), rng.normal(size=(8, 2))
    sums, away = sums_of(H, g - g.mean(axis=0)), np.array([0.7, -0.2])
    alone, sure = covariance(Given(sums, away), sums)  # type: ignore[arg-type]
    assert not sure  # no rollouts by the other law
    for losses, widens in ((rng.uniform(0.9, 1.1, 8), True), (np.full(8, 0.5), True), (rng.uniform(2, 3, 8), False)):
        stage = Given(sums, away, relaxed_losses=losses)
        cov, sure = covariance(stage, sums)  # type: ignore[arg-type]
        np.testing.assert_allclose(cov - alone, widens * np.outer(away, away), atol=1e-6)
        assert sure is not widens
        np.testing.assert_array_equal(stage.x, sums.x)


def test_intervals_cover_the_truth(cube: ObjectModel) -> None:
    truth = cube.with_changes(com=np.array([[2e-3, 0, 5e-3]]), inertia=1.3 * cube.inertia)
    made = noisy(tosses(truth, 60, seed=7, substeps=ModelSettings.substeps), seed=1)
    settings = ModelSettings(learn_geometry=False, learn_inertia=True, implicit=False)
    fit = Fit(ContactNets(cube, settings), made[:45], made[45:])
    list(fit.epochs())
    before = fit.model.learned_object()
    known = parameter_intervals(fit)
    np.testing.assert_array_equal(fit.model.learned_object().inertia, before.inertia)
    assert known["n_tosses"] == 45
    true = {
        "friction": truth.friction,
        **{f"com_{axis}_m": truth.com[0, i] for i, axis in enumerate("xyz")},
        **{f"inertia_{axis}{axis}_kgm2": truth.inertia[0, i, i] for i, axis in enumerate("xyz")},
    }
    assert set(known["intervals"]) == set(true)
    outside = 0
    for name, each in known["intervals"].items():
        low, high = each["ci95"]
        assert low < each["value"] < high, name
        outside += not low < true[name] < high
    assert outside <= 1
    assert known["not_determined"].startswith("total mass")


@pytest.mark.parametrize("seed", [0, 1])
def test_friction_of_few_tosses_is_covered(cube: ObjectModel, seed: int) -> None:
    fit = fit_of(cube, FRICTION, 8, seed=seed, train=5)
    list(fit.epochs())
    known = parameter_intervals(fit)
    low, high = known["intervals"]["friction"]["ci95"]
    assert low < cube.friction < high
    assert high - low < 0.06


def test_a_model_without_rollouts_has_none(cube: ObjectModel) -> None:
    made = tosses(cube, 4, seed=0)
    fit = Fit(ContactNets(cube, ModelSettings()), made[:2], made[2:])
    fit.stages = fit.stages[:1]
    assert parameter_intervals(fit) is None


@pytest.mark.parametrize(("train", "word"), [(1, "one toss has no scatter"), (2, "all that was learned, by 2 tosses")])
def test_too_few_tosses_are_said_in_one_line(cube: ObjectModel, train: int, word: str) -> None:
    fit = fit_of(cube, ModelSettings(learn_inertia=True, implicit=False), 4, seed=3, train=train)
    known = parameter_intervals(fit)
    assert word in known["not_determined"]
    assert "\n" not in known["not_determined"]
    assert all(each["ci95"] is None and each["reason"] for each in known["intervals"].values())


def test_where_the_law_of_contact_is_open_the_centre_of_mass_alone_is_known(
    cube: ObjectModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    fit = fit_of(cube, ModelSettings(learn_geometry=False, learn_inertia=True, implicit=False), 30, seed=4, train=24)
    found = []
    for sure in (True, False):
        monkeypatch.setattr(
            "tossid.training.uncertainty.covariance",
            lambda _, sums, sure=sure, **keys: (1e-8 * np.eye(len(sums.x)), sure),
        )
        known = parameter_intervals(fit)
        found.append(known)
    assert all(each["ci95"] for each in found[0]["intervals"].values())
    reasons = {name: each.get("reason") for name, each in found[1]["intervals"].items()}
    assert reasons == {name: None if "com" in name else OPEN_LAW for name in found[0]["intervals"]}
    assert found[1]["not_determined"].count(OPEN_LAW) == 1


def test_resampled_rigid_contact_is_the_stiffest_spring_where_fitted_contact_yields(cube: ObjectModel) -> None:
    soft, rigid = quantities(cube.with_changes(compliance=1e-4), yields=True), quantities(cube, yields=True)
    assert soft.keys() == rigid.keys()
    assert soft["stiffness_npm"] == pytest.approx(1e4)
    assert rigid["stiffness_npm"] == pytest.approx(float(cube.mass.sum()) / 1e-4**2)
    assert "stiffness_npm" not in quantities(cube, yields=False)
