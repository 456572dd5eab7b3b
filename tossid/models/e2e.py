"""The unstructured baseline: a network that predicts the next velocity, and nothing else.

    v' = v + dt s net(state),   q' = q moved along v' for dt

An end-to-end baseline after Bianchini, Halm and Posa, "Simultaneous Learning of Contact and Continuous Dynamics",
CoRL 2023 (arXiv 2310.12054); the network and its inputs are our own. The state is given in the base's frame, where the
world's symmetries are exact; with the height it is all that a body over a plane depends on.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from tossid.models.protocol import Objective, StagePlan
from tossid.models.registry import register_model
from tossid.models.transitions import Transitions
from tossid.motion import MeasurementModel
from tossid.objects import ObjectModel
from tossid.physics import Simulation, System, make_system, n_features, tree_batch
from tossid.rotations import quat_exp, quat_mul, quat_normalize
from tossid.settings.training import ModelSettings

Array = NDArray[np.float64]

SCALE = 100.0
"""Unit of the network's output [m/s², rad/s²]: an impact changes a velocity by about that much in a frame."""
LARGEST = 1e6
"""A rollout whose state passes this has diverged."""


class EndToEnd(nn.Module):
    """A network from the state to the next velocity.

    Args:
        model: The object; only its number of joints and its width matter.
        hidden: Width of the two hidden layers.
        seed: Of the weights.
    """

    def __init__(self, model: ObjectModel, *, hidden: int = 128, seed: int = 0) -> None:
        super().__init__()
        self.object = model
        generator = torch.Generator().manual_seed(seed)
        self.n_features = n_features(model.n_joints)
        sizes = (1 + self.n_features, hidden, hidden, model.nv)
        self.weights = nn.ParameterList(
            nn.Parameter(torch.randn(b, a, generator=generator, dtype=torch.float64) / a**0.5)
            for a, b in pairwise(sizes)
        )
        self.biases = nn.ParameterList(nn.Parameter(torch.zeros(b, dtype=torch.float64)) for b in sizes[1:])

    def forward(self, height: Tensor, features: Tensor) -> Tensor:
        """Mean acceleration over a frame.

        Args:
            height: (N,), of the base's origin [m].
            features: (N, n_f), of `physics.tree_batch`; those of the world do not enter.

        Returns:
            (N, nv), the linear part in the base's frame [m/s², rad/s²].
        """
        x = torch.cat([(height / self.object.width)[:, None], features[:, : self.n_features]], dim=1)
        last = len(self.weights) - 1
        for i, (W, b) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = x @ W.T + b
            if i < last:
                x = torch.tanh(x)
        return SCALE * x

    def loss(self, transitions: Transitions) -> tuple[Tensor, dict[str, float]]:
        """Mean squared residual of the next velocity, spins counted over half a width [m²/s²]."""
        t = transitions
        predicted = t.dt[:, None] * self(t.z, t.features)
        linear = t.dv[:, :3] - torch.einsum("nij,nj->ni", t.R[:, 0], predicted[:, :3])
        turning = 0.5 * self.object.width * (t.dv[:, 3:] - predicted[:, 3:])
        value = (linear.square().sum(-1) + turning.square().sum(-1)).mean()
        return value, {"prediction": float(value.detach())}

    measurement = MeasurementModel()
    """Exact: a network predicts recorded motion from recorded motion."""

    def stages(self) -> tuple[StagePlan, ...]:
        """One: the error of the next velocity, by Adam, over all weights."""
        return (StagePlan("one-step", Objective.LOSS, list(self.parameters()), optimizer="adam"),)

    def flight_gravity(self, transitions: Transitions) -> float:
        """Mean downward acceleration in free flight, as the network has it [m/s²]."""
        flight = transitions.in_flight()
        with torch.no_grad():
            a = self(flight.z, flight.features)
            return float(-torch.einsum("nij,nj->ni", flight.R[:, 0], a[:, :3])[:, 2].mean())

    def learned_object(self) -> ObjectModel:
        """The object as given: a network knows no geometry and no inertia."""
        return self.object

    def parameters_report(self) -> dict[str, Any]:
        """How many numbers were learned; none has a meaning of its own."""
        return {"n_weights": float(sum(p.numel() for p in self.parameters()))}

    def mechanics(self) -> None:
        """None: a network of motion is no rigid body."""

    def simulator(self) -> NetworkSimulator:
        """Rolls the network out."""
        return NetworkSimulator(self, make_system(self.object))


@dataclass(frozen=True)
class NetworkSimulator:
    """Open-loop use of an `EndToEnd`; a `predictor.Predictor`.

    Attributes:
        network: The model.
        system: The object as given, for the kinematics of the inputs.
    """

    network: EndToEnd
    system: System
    corner_pos: None = None

    def rollout(
        self, q0: Array, v0: Array, *, n_steps: int | NDArray[np.int64], dt: float, n_threads: int = 1
    ) -> Simulation:
        """Roll out frame by frame, all tosses at once; `lam_n` is zero, as a network knows no impulses.

        Args:
            q0: (B, nq).
            v0: (B, nv).
            n_steps: Frames to predict, for all or for each.
            dt: Length of a frame [s].
            n_threads: Unused.
        """
        count, model = len(q0), self.network.object
        steps = np.broadcast_to(np.asarray(n_steps, dtype=np.int64), (count,))
        T = int(steps.max())
        q, v = np.empty((count, T + 1, model.nq)), np.empty((count, T + 1, model.nv))
        q[:, 0], v[:, 0] = q0, v0
        finite = np.ones(count, dtype=bool)
        for k in range(T):
            new_v = v[:, k] + dt * self.acceleration(q[:, k], v[:, k])
            new_q = q[:, k].copy()
            new_q[:, :3] += dt * new_v[:, :3]
            new_q[:, 3:7] = quat_normalize(quat_mul(q[:, k, 3:7], quat_exp(dt * new_v[:, 3:6])))
            new_q[:, 7:] += dt * new_v[:, 6:]
            good = np.isfinite(new_q).all(1) & (np.abs(new_v).max(1) < LARGEST)
            finite &= good | (k >= steps)
            go = good & finite & (k < steps)
            q[:, k + 1], v[:, k + 1] = np.where(go[:, None], new_q, q[:, k]), np.where(go[:, None], new_v, v[:, k])
        nothing = np.zeros((count, T, model.n_corners))
        return Simulation(q, v, nothing, np.zeros(count, dtype=np.int64), np.zeros(count), finite)

    def acceleration(self, q: Array, v: Array) -> Array:
        """Mean acceleration over a frame (N, nv), at (N, nq), (N, nv), in v's frames [m/s², rad/s²]."""
        batch = tree_batch(self.system, np.ascontiguousarray(q), np.ascontiguousarray(v))
        with torch.no_grad():
            a = self.network(torch.from_numpy(batch.x[:, 0, 2].copy()), torch.from_numpy(batch.features)).numpy()
        return np.concatenate([np.einsum("nij,nj->ni", batch.R[:, 0], a[:, :3]), a[:, 3:]], axis=1)


def build(
    settings: ModelSettings, given: ObjectModel, *, seed: int = 0, measurement: MeasurementModel | None = None
) -> EndToEnd:
    """The untrained network.

    Args:
        settings: Of its fields, `hidden` counts.
        given: The object.
        seed: Of the weights.
        measurement: Unused: recorded motion is predicted as it is.
    """
    return EndToEnd(given, hidden=settings.hidden, seed=seed)


register_model("e2e", ModelSettings, build)
