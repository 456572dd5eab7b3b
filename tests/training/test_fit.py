"""The fit: inertia, gravity and contact law recovered from rollouts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.models.made import tosses
from tossid.errors import DivergedError
from tossid.models.contactnets import ContactNets
from tossid.motion import MeasurementModel
from tossid.objects import ObjectModel
from tossid.physics.identifiable import base_parameters
from tossid.settings.training import ModelSettings, TrainSettings
from tossid.training.fit import Fit

COM = np.array([[1e-3, -2e-3, 6e-3]])


def test_inertia_and_contact_law_come_back_from_rollouts(cube: ObjectModel) -> None:
    law = {"compliance": 1 / 30e3, "relaxation": 3.28e-3, "cohesion": 0.05}
    truth = cube.with_changes(com=COM, inertia=1.4 * cube.inertia, **law)
    made = tosses(truth, 28, seed=3, substeps=ModelSettings.substeps)
    settings = ModelSettings(learn_geometry=False, learn_inertia=True, learn_contact_law=True, implicit=False)
    model = ContactNets(cube.with_changes(friction=0.25), settings)
    records = list(Fit(model, made[:21], made[21:]).epochs())
    learned = model.learned_object()
    assert records[-1].validation_loss < 1e-3  # a twentieth of a nearly rigid start's
    assert learned.friction == pytest.approx(truth.friction, rel=0.02)
    assert learned.cohesion == pytest.approx(law["cohesion"], abs=0.02)
    assert learned.compliance > 0
    assert learned.relaxation > 0
    assert np.abs(learned.com - COM).max() < 3e-4
    np.testing.assert_allclose(learned.inertia[0], truth.inertia[0], atol=0.04 * truth.inertia[0, 0, 0])
    assert model.parameters_report()["stiffness_npm"] == pytest.approx(1 / learned.compliance)


def test_the_inertia_of_links_comes_back_from_stretches(elbow: ObjectModel) -> None:
    """Begun with links that are too round and balanced, as the published ones are; what motion tells comes back."""
    thin = np.diag([0.3, 0.6, 0.6])
    truth = elbow.with_changes(inertia=elbow.inertia @ thin, com=elbow.com + np.diag([0.01, 0.008, 0])[:2])
    made = tosses(truth, 16, seed=4, substeps=ModelSettings.substeps)
    settings = ModelSettings(learn_geometry=False, learn_inertia=True, implicit=False)
    model = ContactNets(elbow, settings)
    fit = Fit(model, made[:12], made[12:])
    assert [plan.name for plan in fit.stages] == ["rollout-10", "rollout-20"]
    list(fit.epochs())
    errors = base_parameters(elbow).errors
    assert errors(elbow, truth).max() > 0.1
    assert errors(model.learned_object(), truth).max() < 0.01


def test_contact_stays_rigid_where_a_softer_one_explains_little(cube: ObjectModel) -> None:
    """What a soft contact would gain at a wrong inertia is the inertia's."""
    made = tosses(cube.with_changes(com=COM), 28, seed=3, substeps=ModelSettings.substeps)
    settings = ModelSettings(learn_geometry=False, learn_inertia=True, learn_contact_law=True, implicit=False)
    model = ContactNets(cube.with_changes(inertia=1.08 * cube.inertia), settings)
    list(Fit(model, made[:21], made[21:]).epochs())
    learned = model.learned_object()
    assert learned.compliance < 1e-7
    assert learned.cohesion < 2e-3
    assert np.abs(learned.com - COM).max() < 2e-4
    np.testing.assert_allclose(learned.inertia[0], cube.inertia[0], atol=0.01 * cube.inertia[0, 0, 0])


def test_short_lengths_and_late_velocities_do_not_spoil_what_is_learned(cube: ObjectModel) -> None:
    truth = cube.with_changes(com=COM)
    lag, scale = 0.5 / 148, 0.95
    recorded = []
    for toss in tosses(truth, 14, seed=3, substeps=ModelSettings.substeps):
        q, v = toss.q.copy(), toss.v.copy()
        v[:, 2] += 9.81 * lag
        q[:, :3] *= scale
        v[:, :3] *= scale
        recorded.append(replace(toss, q=q, v=v))
    settings = ModelSettings(gravity=0.0, learn_geometry=False, learn_inertia=True, learn_k_res=True)
    model = ContactNets(cube, settings, measurement=MeasurementModel(scale, lag))
    fit = Fit(model, recorded[:10], recorded[10:], TrainSettings(epochs=12))
    list(fit.epochs())
    assert model.flight_gravity(fit.transitions[0]) == pytest.approx(9.81, rel=0.01)
    assert np.abs(model.learned_object().com - COM).max() < 1e-3


def test_one_epoch_finds_a_gravity_that_was_not_given(cube: ObjectModel) -> None:
    """Its first step would else leap along inertia, too: to 1e14 kg m² of the published cube's tosses."""
    made = tosses(cube.with_changes(com=COM), 12, seed=5)
    settings = ModelSettings(learn_inertia=True, learn_k_res=True, hidden=4, horizons=(), gravity=0.0)
    model = ContactNets(cube, settings)
    fit = Fit(model, made[:8], made[8:], TrainSettings(epochs=1))
    list(fit.epochs())
    assert model.mechanics().carried_gravity == pytest.approx(9.81, abs=0.2)
    assert np.trace(model.learned_object().inertia[0]) == pytest.approx(np.trace(cube.inertia[0]), rel=0.5)


def test_a_stage_that_leaves_no_body_is_a_failure_with_its_name(cube: ObjectModel) -> None:
    class Runaway(ContactNets):
        def learned_object(self) -> ObjectModel:
            learned = super().learned_object()
            return learned if abs(learned.friction - 0.3) < 1e-9 else cube.with_changes(friction=-1.0)

    made = tosses(cube, 6, seed=0)
    model = Runaway(cube.with_changes(friction=0.3), ModelSettings(horizons=()))
    fit = Fit(model, made[:4], made[4:], TrainSettings(epochs=2))
    with pytest.raises(DivergedError, match=r"stage 'contact' ran away from every body .* more epochs than"):
        list(fit.epochs())
