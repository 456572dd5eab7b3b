"""Stages: minima of known losses, flights that show the body, and the sums of rollouts."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from tests.models.made import tosses
from tossid.models import variant
from tossid.models.contactnets import ContactNets
from tossid.models.protocol import Objective, StagePlan
from tossid.models.transitions import Transitions, make_transitions
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp, quat_mul, quat_normalize
from tossid.settings.training import ModelSettings, TrainSettings
from tossid.training import prediction as prediction_error
from tossid.training import rollouts
from tossid.training.fit import Fit
from tossid.training.flights import FlightStage, first_states_of_flights
from tossid.training.losses import LossStage
from tossid.training.rollouts import AveragedQuadratics, RolloutStage, clearly_better
from tossid.types import Toss


class Falling(nn.Module):
    """Predicts the change of the vertical velocity by one number; its best value is the mean acceleration."""

    def __init__(self) -> None:
        super().__init__()
        self.a = nn.Parameter(torch.zeros((), dtype=torch.float64))

    def loss(self, transitions: Transitions) -> tuple[Tensor, dict[str, float]]:
        return (transitions.dv[:, 2] / transitions.dt - self.a).square().mean(), {}


def stage_of(cube: ObjectModel, settings: TrainSettings, optimizer: str | None = None) -> tuple[Any, LossStage, float]:
    data = make_transitions(cube, tosses(cube, 4, seed=0))
    model = Falling()
    plan = StagePlan("fall", Objective.LOSS, [model.a], optimizer=optimizer)
    best = float((data.dv[:, 2] / data.dt).mean())
    return model, LossStage(plan, model, data, data, settings), best  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("settings", "steps", "optimizer"),
    [
        (TrainSettings(), 5, None),
        (TrainSettings(optimizer="adam", learning_rate=0.1, batch=10_000), 300, None),
        (TrainSettings(learning_rate=0.1, batch=10_000), 300, "adam"),
    ],
)
def test_the_minimum_is_reached(cube: ObjectModel, settings: TrainSettings, steps: int, optimizer: str | None) -> None:
    model, stage, best = stage_of(cube, settings, optimizer)
    losses = [stage.step().validation_loss for _ in range(steps)]
    assert losses[-1] == pytest.approx(min(losses))
    assert float(model.a.detach()) == pytest.approx(
        best, abs=0.5 if "adam" in (optimizer, settings.optimizer) else 1e-6
    )


WITHOUT_COMPILER = """
import sys
from tests.training.test_stages import stage_of
from tossid.objects import load_object
from tossid.settings.training import TrainSettings

_, stage, _ = stage_of(load_object("cube"), TrainSettings())
stage.step()
stage.load_state_dict(stage.state_dict())
stage.step()
assert "torch._dynamo" not in sys.modules
import torch
assert not hasattr(torch.optim.Optimizer.add_param_group.__wrapped__, "__dynamo_disable")
"""


def test_l_bfgs_does_without_torchs_compiler() -> None:
    subprocess.run([sys.executable, "-c", WITHOUT_COMPILER], check=True)


def test_a_parameter_in_which_the_loss_is_quadratic_starts_at_its_minimum(cube: ObjectModel) -> None:
    data = make_transitions(cube, tosses(cube, 4, seed=0))
    model = Falling()
    plan = StagePlan("fall", Objective.LOSS, [model.a], quadratic=model.a)
    LossStage(plan, model, data, data, TrainSettings()).begin()  # type: ignore[arg-type]
    assert float(model.a.detach()) == pytest.approx(float((data.dv[:, 2] / data.dt).mean()), rel=1e-12)


# ---------------------------------------------------------------- flights


def test_first_states_are_outdated_by_what_they_depend_on(cube: ObjectModel) -> None:
    made = tosses(cube, 6, seed=2)
    flights = first_states_of_flights(cube, (made[:4], made[4:]), 9.81)
    assert [len(each) for each in flights.states] == [4, 2]
    assert not flights.outdated(cube.with_changes(friction=0.5, corner_pos=1.1 * cube.corner_pos), 9.81)
    assert not flights.outdated(cube.with_changes(inertia=1.005 * cube.inertia), 9.815)
    assert flights.outdated(cube.with_changes(inertia=1.02 * cube.inertia), 9.81)
    assert flights.outdated(cube.with_changes(com=cube.com + np.array([1e-3, 0, 0])), 9.81)
    assert flights.outdated(cube, 9.7)


def measured(thrown: list[Toss]) -> list[Toss]:
    """The tosses with 0.05 mm and 0.5 mrad of noise, as stated."""
    rng, cov = np.random.default_rng(0), np.diag([5e-5] * 3 + [5e-4] * 3) ** 2
    found = []
    for toss in thrown:
        noise, q = rng.multivariate_normal(np.zeros(6), cov, len(toss)), toss.q.copy()
        q[:, :3] += noise[:, :3]
        q[:, 3:7] = quat_normalize(quat_mul(q[:, 3:7], quat_exp(noise[:, 3:])))
        found.append(replace(toss, q=q, q_cov=np.tile(cov, (len(toss), 1, 1))))
    return found


def flight_stage(start: ObjectModel, cube: ObjectModel, settings: ModelSettings) -> tuple[ContactNets, FlightStage]:
    """The stage and its model, from a start, on tosses of the cube; begun."""
    model, made = ContactNets(start, settings), measured(tosses(cube, 32, seed=5))
    stage = FlightStage(model.stages()[0], model, (made[:24], made[24:]), TrainSettings())
    stage.begin()
    return model, stage


def test_flight_shows_centre_of_mass_ratios_of_inertia_and_gravity(cube: ObjectModel) -> None:
    start = cube.with_changes(
        com=cube.com + np.array([4e-3, -6e-3, 2e-3]), inertia=cube.inertia * np.array([1.3, 1.0, 0.9])[:, None]
    )
    model, stage = flight_stage(start, cube, replace(variant("cnrpi"), gravity=2.0))
    before = stage.validation_loss()
    while not stage.step().done:
        pass
    mechanics = model.mechanics()
    moments = np.diag(mechanics.object.inertia[0])
    assert mechanics.carried_gravity == pytest.approx(9.81, abs=0.03)
    np.testing.assert_allclose(mechanics.object.com, cube.com, atol=1e-3)
    np.testing.assert_allclose(moments / moments.mean(), 1.0, atol=0.03)
    assert stage.validation_loss() < before


def test_the_size_of_inertia_is_left_where_it_was(cube: ObjectModel) -> None:
    model, stage = flight_stage(cube.with_changes(inertia=2 * cube.inertia), cube, variant("cnrpi"))
    for _ in range(3):
        stage.step()
    assert np.trace(model.learned_object().inertia[0]) == pytest.approx(2 * np.trace(cube.inertia[0]), rel=0.01)


def test_a_body_that_validation_flights_contradict_is_undone(cube: ObjectModel) -> None:
    wrong = cube.with_changes(com=cube.com + np.array([0.0, 5e-3, 0.0]))
    model = ContactNets(cube, replace(variant("cnrpi"), horizons=(), implicit=False, gravity=0.0))
    fit = Fit(model, measured(tosses(wrong, 3, seed=6)), measured(tosses(cube, 3, seed=7)))
    stages = [record.stage for record in fit.epochs()]
    assert stages[0] == "flight"
    np.testing.assert_array_equal(model.learned_object().com, cube.com)
    assert model.flight_gravity(fit.transitions[1]) == pytest.approx(9.81, abs=0.15)


# ---------------------------------------------------------------- rollouts


SETTINGS = ModelSettings(learn_geometry=False, implicit=False, horizons=(20,))


def rollout_stage(cube: ObjectModel, friction: float) -> tuple[ContactNets, RolloutStage]:
    made = tosses(cube, 8, seed=1, substeps=SETTINGS.substeps)
    model = ContactNets(cube.with_changes(friction=friction), SETTINGS)
    fit = Fit(model, made[:6], made[6:])
    prediction = fit.longest_prediction()
    return model, RolloutStage(fit.stages[-1], prediction, fit.settings.rollout_epochs)


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


def test_sums_are_the_gradient_of_the_loss_to_both_sides_and_to_one(
    cube: ObjectModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With all frames counted and a loss that is quadratic, g is half the slope of the mean squared error."""
    for name, value in (("CHAOTIC_SHARE", 0.0), ("HUBER", 1e3), ("DIFFERENCE", 1e-4)):
        monkeypatch.setattr(prediction_error, name, value)
    prediction = rollout_stage(cube, 0.2)[1].prediction
    both = prediction.gauss_newton()
    losses = []
    for by in (1e-4, -1e-4):
        prediction.set_parameters(both.x + by)
        losses.append(prediction.training_loss())
    assert len(both.g) == 6
    assert both.g.sum() == pytest.approx((losses[0] - losses[1]) / 2e-4, rel=1e-3)
    assert (both.H.sum(0) > 0).all()
    prediction.set_parameters(both.x)
    prediction.central = False
    one = prediction.gauss_newton()
    np.testing.assert_allclose(one.H.sum(0), both.H.sum(0), rtol=0.02)
    np.testing.assert_allclose(one.g.sum(0), both.g.sum(0), rtol=0.02)


def test_a_race_on_some_tosses_chooses_the_start_that_all_of_them_choose(
    cube: ObjectModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = []
    for raced in (2, 100):
        monkeypatch.setattr(prediction_error, "RACED_TOSSES", raced)
        model, stage = rollout_stage(cube, 1.0)
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
