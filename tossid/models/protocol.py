"""What every model offers to training and evaluation."""

from __future__ import annotations

from typing import Any, Protocol

from torch import Tensor, nn

from tossid.models.predictor import Predictor
from tossid.models.transitions import Transitions
from tossid.motion import Measurement
from tossid.objects import ObjectModel


class DynamicsModel(Protocol):
    """A learnable model of an object's motion.

    `object` is what was given. A model names its stages of training and what
    each of them learns; a stage "rollout-N" minimises the open-loop prediction
    error over N frames, "continuous" the loss in free flight, any other the loss.
    """

    object: ObjectModel

    @property
    def measurement(self) -> Measurement:
        """How recorded motion relates to the model's."""

    def stages(self, horizons: tuple[int, ...]) -> tuple[str, ...]:
        """Names of the stages, in order."""

    def stage_parameters(self, stage: str) -> list[nn.Parameter]:
        """What the stage learns."""

    def loss(self, transitions: Transitions) -> tuple[Tensor, dict[str, float]]:
        """Mean loss and its parts."""

    def simulator(self) -> Predictor:
        """The model as it is now, for rollouts."""

    def learned_object(self) -> ObjectModel:
        """The object with what was learned in place of what was given."""

    def flight_gravity(self, transitions: Transitions) -> float:
        """Mean downward acceleration in free flight [m/s²]."""

    def parameters_report(self) -> dict[str, Any]:
        """What was learned and what was given, with units in the names."""

    def state_dict(self) -> dict[str, Any]:
        """Torch's."""

    def load_state_dict(self, state: dict[str, Any]) -> Any:
        """Torch's."""
