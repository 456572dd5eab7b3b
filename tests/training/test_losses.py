"""Loss stages: both optimizers reach the minimum of a loss that is known."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from tests.models.made import tosses
from tossid.models.protocol import Objective, StagePlan
from tossid.models.transitions import Transitions, make_transitions
from tossid.objects import ObjectModel
from tossid.settings.training import TrainSettings
from tossid.training.losses import LossStage


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
from tests.training.test_losses import stage_of
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
