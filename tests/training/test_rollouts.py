"""The rollout stage: Gauss-Newton's sums against differences of the loss, and friction that comes back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.models.made import tosses
from tossid.models.contactnets import ContactNets
from tossid.objects import ObjectModel
from tossid.settings.training import ModelSettings
from tossid.training import prediction as prediction_error
from tossid.training import rollouts
from tossid.training.fit import Fit
from tossid.training.rollouts import AveragedQuadratics, RolloutStage, clearly_better

SETTINGS = ModelSettings(learn_geometry=False, implicit=False, horizons=(20,))


def stage_of(cube: ObjectModel, friction: float) -> tuple[ContactNets, RolloutStage]:
    made = tosses(cube, 8, seed=1, substeps=SETTINGS.substeps)
    model = ContactNets(cube.with_changes(friction=friction), SETTINGS)
    fit = Fit(model, made[:6], made[6:])
    prediction = fit.longest_prediction()
    return model, RolloutStage(fit.stages[-1], prediction, fit.settings.rollout_epochs)


def test_friction_comes_back(cube: ObjectModel) -> None:
    model, stage = stage_of(cube, 0.25)
    losses = [stage.step().train_loss for _ in range(8)]
    assert losses[:5] == sorted(losses[:5], reverse=True)
    assert max(losses[5:]) < 1e-12  # there, only calm frames are sure to be predicted better
    assert model.learned_object().friction == pytest.approx(cube.friction, rel=0.01)


def test_noisy_tosses_lead_to_one_friction_from_above_and_below(cube: ObjectModel) -> None:
    """Where chaotic frames have a say in whether a step is taken, these four end 0.0044 apart."""
    rng, ends = np.random.default_rng(5), []
    made = tosses(cube, 16, seed=3, substeps=SETTINGS.substeps)
    noisy = [replace(toss, v=toss.v + 0.06 * rng.normal(size=toss.v.shape)) for toss in made]
    for friction in (0.14, 0.16, 0.2, 0.24):
        model = ContactNets(cube.with_changes(friction=friction), replace(SETTINGS, horizons=(60,)))
        records = list(Fit(model, noisy[:14], noisy[14:]).epochs())
        assert records[-1].best  # the last step counts, whatever two tosses say
        ends.append(model.learned_object().friction)
    assert np.ptp(ends) < 3.5e-3


def test_the_gradient_is_that_of_the_loss(cube: ObjectModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """With all frames counted and a loss that is quadratic, g is half the slope of the mean squared error."""
    for name, value in (("CHAOTIC_SHARE", 0.0), ("HUBER", 1e3), ("DIFFERENCE", 1e-4)):
        monkeypatch.setattr(prediction_error, name, value)
    _, stage = stage_of(cube, 0.2)
    prediction = stage.prediction
    sums = prediction.gauss_newton()
    losses = []
    for by in (1e-4, -1e-4):
        prediction.set_parameters(sums.x + by)
        losses.append(prediction.training_loss())
    assert sums.g.sum() == pytest.approx((losses[0] - losses[1]) / 2e-4, rel=1e-3)
    assert (sums.H.sum(0) > 0).all()
    np.testing.assert_array_equal(len(sums.g), 6)


def test_differences_to_one_side_agree_with_those_to_both(cube: ObjectModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(prediction_error, "DIFFERENCE", 1e-4)
    _, stage = stage_of(cube, 0.2)
    both = stage.prediction.gauss_newton()
    stage.prediction.central = False
    one = stage.prediction.gauss_newton()
    np.testing.assert_allclose(one.H.sum(0), both.H.sum(0), rtol=0.02)
    np.testing.assert_allclose(one.g.sum(0), both.g.sum(0), rtol=0.02)


def test_a_race_on_some_tosses_chooses_the_start_that_all_of_them_choose(
    cube: ObjectModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = []
    for raced in (2, 100):
        monkeypatch.setattr(prediction_error, "RACED_TOSSES", raced)
        model, stage = stage_of(cube, 1.0)
        stage.begin()
        assert stage.friction_restarted
        found.append(model.learned_object().friction)
    assert found[0] == found[1] == pytest.approx(0.15)


def test_averaged_quadratics_have_the_weighted_mean_of_their_minima() -> None:
    H, minima = np.diag([2.0, 5.0]), np.array([[1.0, 0.0], [0.0, 3.0], [-1.0, 1.0]])
    averaged = AveragedQuadratics(np.zeros((2, 2)), np.zeros(2))
    for minimum in minima:
        averaged = averaged.with_quadratic(H, H @ minimum)
    np.testing.assert_allclose(np.linalg.solve(averaged.H, averaged.b), np.array([1, 2, 3]) @ minima / 6)


def test_where_contact_yields_the_last_stage_settles_and_resumes(
    cube: ObjectModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in (("LEAST_GAIN", 1.0), ("SETTLING", 3), ("SETTLED", 1e-9)):  # one step, and then averaged ones
        monkeypatch.setattr(rollouts, name, value)
    truth = cube.with_changes(compliance=1 / 30e3, relaxation=3e-3, cohesion=0.05)
    rng, made = np.random.default_rng(5), tosses(truth, 8, seed=1, substeps=SETTINGS.substeps)
    noisy = [replace(toss, v=toss.v + 0.03 * rng.normal(size=toss.v.shape)) for toss in made]

    def fresh() -> tuple[ContactNets, Fit]:
        model = ContactNets(cube, replace(SETTINGS, learn_contact_law=True))
        return model, Fit(model, noisy[:6], noisy[6:])

    model, whole = fresh()
    assert len(list(whole.epochs())) == 1 + 3
    _, first = fresh()
    steps = first.epochs()
    for _ in range(2):
        next(steps)
    other, second = fresh()
    second.load_state_dict(first.state_dict())
    assert len(list(second.epochs())) == 2
    assert other.learned_object().friction == model.learned_object().friction
    assert model.learned_object().compliance > 0


@pytest.mark.parametrize(
    ("train", "validation", "better"),
    [
        ([0.5, 0.6, 0.4], [0.5], True),  # by a share, and on all tosses
        ([1.1, 0.1, 0.9], [0.5], False),  # by a share of the one toss alone
        ([0.9, 0.9, 0.9], [0.95], False),  # by too little for one toss
        ([1.0, 1.0, 1.0], [0.95, 0.94, 0.96, 0.95], True),  # by little, on every validation toss
        ([0.1, 0.1, 0.1], [1.2], False),  # on training tosses alone
    ],
)
def test_a_rival_gives_way_to_what_is_clearly_better(train: list[float], validation: list[float], better: bool) -> None:
    rival = np.ones(len(train)), np.ones(len(validation))
    assert clearly_better((np.array(train), np.array(validation)), rival) is better
