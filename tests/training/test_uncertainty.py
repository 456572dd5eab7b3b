"""Intervals of what rollouts taught: they cover the truth, and say what is not seen."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.models.made import tosses
from tossid.models.contactnets import ContactNets
from tossid.objects import ObjectModel
from tossid.settings.training import ModelSettings
from tossid.training.fit import Fit
from tossid.training.rollouts import GaussNewton, RolloutStage
from tossid.training.uncertainty import _readings, parameter_intervals
from tossid.types import Toss


def noisy(made: list[Toss], *, seed: int) -> list[Toss]:
    """The tosses with first velocities off by 2 cm/s and 0.1 rad/s."""
    rng = np.random.default_rng(seed)
    return [
        Toss(t.name, t.t, t.q, t.v + rng.normal(size=6) * [0.02, 0.02, 0.02, 0.1, 0.1, 0.1], t.q_cov, t.v_cov, t.phase)
        for t in made
    ]


def test_intervals_cover_the_truth(cube: ObjectModel) -> None:
    truth = cube.with_changes(com=np.array([[2e-3, 0, 5e-3]]), inertia=1.3 * cube.inertia)
    made = noisy(tosses(truth, 60, seed=7, substeps=ModelSettings.substeps), seed=1)
    settings = ModelSettings(learn_geometry=False, learn_inertia=True, implicit=False)
    fit = Fit(ContactNets(cube, settings), made[:45], made[45:])
    list(fit.epochs())
    before = fit.model.learned_object()
    known = parameter_intervals(fit)
    assert known is not None
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
        outside += not low - 0.5 * (high - low) < true[name] < high + 0.5 * (high - low)
    assert outside <= 1
    assert known["not_seen"][0].startswith("total mass")


def test_a_model_without_rollouts_has_none(cube: ObjectModel) -> None:
    made = tosses(cube, 4, seed=0)
    fit = Fit(ContactNets(cube, ModelSettings()), made[:2], made[2:])
    fit.stages = fit.stages[:1]
    assert parameter_intervals(fit) is None


def test_resampled_tosses_that_lead_to_no_body_are_counted(cube: ObjectModel, monkeypatch: pytest.MonkeyPatch) -> None:
    made = noisy(tosses(cube, 8, seed=3, substeps=ModelSettings.substeps), seed=2)
    fit = Fit(ContactNets(cube, ModelSettings(learn_inertia=True, implicit=False)), made[:3], made[3:])
    wide = RolloutStage.gauss_newton

    def steep(stage: RolloutStage, *args: Any, **kwargs: Any) -> GaussNewton:
        """Sums whose second and third toss pull apart by a hundred in every parameter's unit."""
        sums = wide(stage, *args, **kwargs)
        n, size = sums.g.shape
        g = 100.0 * np.arange(n)[:, None] * np.ones(size)
        return sums._replace(H=np.tile(np.eye(size), (n, 1, 1)), g=g - g.mean(axis=0))

    monkeypatch.setattr(RolloutStage, "gauss_newton", steep)
    known = parameter_intervals(fit)
    assert known is not None
    (said,) = [text for text in known["not_seen"] if "lead to no body" in text]
    assert 0 < int(said.split()[0]) < fit.settings.intervals.draws
    assert all(np.isfinite(each["ci95"]).all() for each in known["intervals"].values())


def test_resampled_rigid_contact_is_the_stiffest_spring_where_fitted_contact_yields(cube: ObjectModel) -> None:
    soft, rigid = _readings(cube.with_changes(compliance=1e-4), yields=True), _readings(cube, yields=True)
    assert soft.keys() == rigid.keys()
    assert soft["stiffness_npm"] == pytest.approx(1e4)
    assert rigid["stiffness_npm"] == pytest.approx(float(cube.mass.sum()) / 1e-4**2)
    assert "stiffness_npm" not in _readings(cube, yields=False)
