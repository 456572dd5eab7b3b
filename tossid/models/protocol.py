"""What every model offers to training, evaluation, export and diagnosis."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from torch import Tensor, nn

from tossid.models.implicit import LossWeights
from tossid.models.parameters import ContactLaw, Friction, Geometry
from tossid.models.predictor import Predictor
from tossid.models.transitions import Transitions
from tossid.motion import MeasurementModel
from tossid.objects import ObjectModel
from tossid.physics import LearnedAcceleration, System, learned_accelerations, make_system

Array = NDArray[np.float64]


class Objective(Enum):
    """What a stage of training minimises."""

    FLIGHT = auto()
    """the misfit of measured poses in free flight, weighted by their covariances; of a rigid body"""
    FLIGHT_LOSS = auto()
    """the model's own loss, on transitions in free flight"""
    LOSS = auto()
    """the model's own loss, on all transitions"""
    ROLLOUT = auto()
    """the error of open-loop predictions"""


@dataclass(frozen=True)
class StagePlan:
    """One stage of training: what is learned, and what is minimised.

    Attributes:
        name: What the stage is called in records, such as "contact" or "rollout-20".
        objective: What it minimises.
        parameters: What it learns.
        horizon: Frames of a rollout after first contact, or of a stretch. Unused by losses.
        optimizer: Of a loss, where the model needs a certain one; None for the one of the settings.
        contact_law: That a rollout stage learns. Its error has several minima in it, so that several starts are
            compared before the first step.
        corners: Corners that the stage learns, which are started again where the tosses contradict them.
        friction: That a rollout stage learns, whose starts are compared before the first step.
        quadratic: One of its parameters, in which the loss is quadratic: it starts at the minimum along it. A gravity
            that is given 9.81 m/s² wrong is then found at once, and no first step along all parameters leaps for it.
        judged: Whether what it learns counts only if it lowers the loss of validation tosses: few tosses are fitted
            better by any body with more freedom, and others worse.
        rival: Whether training ends with what it leaves, unless the last stage predicts validation tosses clearly
            better. Contact is rigid in it.
    """

    name: str
    objective: Objective
    parameters: list[nn.Parameter]
    horizon: int = 0
    optimizer: str | None = None
    contact_law: ContactLaw | None = None
    corners: Geometry | None = None
    friction: Friction | None = None
    quadratic: nn.Parameter | None = None
    judged: bool = False
    rival: bool = False


@dataclass(frozen=True)
class Mechanics:
    """A model as rigid bodies with contact: what other simulators, exports and reports take from it.

    Attributes:
        object: The object with what was learned in place of what was given.
        gravity: Downward acceleration of the given continuous dynamics k_hat [m/s²].
        k_res: The learned acceleration, None where there is none.
        vertical: Its uniform vertical part, up positive [m/s²].
        weights: With which contact was learned by the implicit loss; None for the defaults.
    """

    object: ObjectModel
    gravity: float
    k_res: LearnedAcceleration | None = None
    vertical: float = 0.0
    weights: LossWeights | None = None

    @property
    def carried_gravity(self) -> float:
        """Downward acceleration of k_hat and the uniform part of k_res: a simulator's gravity [m/s²]."""
        return self.gravity - self.vertical

    def system(self) -> System:
        """The numbers that the simulator takes."""
        return make_system(self.object, gravity=self.gravity, k_res=self.k_res)

    def k_res_without_vertical(self, features: Array) -> Array:
        """What k_res adds beyond its uniform vertical part.

        Args:
            features: (N, n_f), of `physics.tree_batch`.

        Returns:
            (N, nv), in the base's frame [m/s², rad/s²].
        """
        if self.k_res is None:
            return np.zeros((len(features), self.object.nv))
        out = learned_accelerations(self.k_res, features, self.object.nv)
        out[:, :3] -= self.vertical * features[:, :3]
        return out


class DynamicsModel(Protocol):
    """A learnable model of an object's motion.

    Attributes:
        object: The object as it was given.
    """

    object: ObjectModel

    @property
    def measurement(self) -> MeasurementModel:
        """How recorded motion relates to the model's."""

    def stages(self) -> tuple[StagePlan, ...]:
        """The stages of its training, in order."""

    def loss(self, transitions: Transitions) -> tuple[Tensor, dict[str, float]]:
        """Mean loss and its parts."""

    def simulator(self) -> Predictor:
        """The model as it is now, for rollouts: it stays so where the model goes on to other parameters."""

    def mechanics(self) -> Mechanics | None:
        """The model as rigid bodies with contact; None for one that is no such thing."""

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
