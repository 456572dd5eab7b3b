"""ContactNets: an object's contact, and on demand its continuous dynamics, learned by the implicit loss.

The three variants differ in what they learn (`cn.py`, `cnrp.py`, `cnrpi.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from tossid.models.implicit import Dynamics, LossTerms, LossWeights, free_acceleration, implicit_loss
from tossid.models.inertia import divergence, make_inertia
from tossid.models.parameters import SCALE, ContactLaw, Friction, Geometry, ResidualNet
from tossid.models.predictor import Simulator
from tossid.models.transitions import Transitions
from tossid.motion import Measurement
from tossid.objects import GRAVITY, ObjectModel
from tossid.physics import System, make_system


@dataclass(frozen=True)
class ContactNetsSettings:
    """What is given to a ContactNets model and how its loss is weighed.

    Attributes:
        gravity: downward acceleration of the given continuous dynamics k_hat [m/s²].
        learn_geometry, learn_friction, learn_contact_law, learn_residual, learn_inertia: what is
            learned. The contact law (`parameters.ContactLaw`) is learned from rollouts only.
        inertia: parameterisation of the inertia (`inertia.KINDS`).
        hidden: width of the residual's hidden layers.
        residual_weight: weight of the mean squared residual acceleration but for its uniform vertical part.
        inertia_weight: of a tree's `inertia.divergence` from the given in the implicit loss [m²/s²]. By itself that
            loss finds light links good, which little impulse moves wherever the data are: real tosses took one from
            0.37 kg to 0.2 g. Rollouts have no such term.
        weights: of the loss's terms.
        implicit: contact is learned by the implicit loss first; False (diffsim) learns it from rollouts alone.
        refine_geometry: rollouts learn the corners too.
    """

    gravity: float = GRAVITY
    learn_geometry: bool = True
    learn_friction: bool = True
    learn_contact_law: bool = False
    learn_residual: bool = False
    learn_inertia: bool = False
    inertia: str = "log_cholesky"
    hidden: int = 16
    residual_weight: float = 1e-6
    inertia_weight: float = 2e-4
    weights: LossWeights = field(default_factory=LossWeights)
    implicit: bool = True
    refine_geometry: bool = False


class ContactNets(nn.Module):
    """A learnable rigid body (or tree) over the ground.

    Args:
        model: the object as given: the start of everything learned, and the truth of the rest.
        settings: what is learned and given.
        seed: for the residual's weights.
        measurement: how recorded motion relates to the model's.
    """

    def __init__(
        self,
        model: ObjectModel,
        settings: ContactNetsSettings,
        *,
        seed: int = 0,
        measurement: Measurement | None = None,
    ) -> None:
        super().__init__()
        measurement = measurement or Measurement()
        recorded = [measurement.length_scale, measurement.velocity_lag]
        self.register_buffer("recorded", torch.tensor(recorded, dtype=torch.float64))
        self.object = model
        self.settings = settings
        self.corner_body = torch.as_tensor(model.corner_body)
        self.geometry = Geometry(model, learn=settings.learn_geometry)
        self.friction = Friction(model, learn=settings.learn_friction)
        self.contact_law = ContactLaw(model, learn=settings.learn_contact_law)
        self.inertia = make_inertia(model, kind=settings.inertia, learn=settings.learn_inertia)
        self.residual: ResidualNet | None = None
        if settings.learn_residual:
            generator = torch.Generator().manual_seed(seed)
            self.residual = ResidualNet(model.n_joints, hidden=settings.hidden, generator=generator)
        with torch.no_grad():
            self._metric = tuple(part.clone() for part in make_inertia(model, learn=False)())

    @property
    def measurement(self) -> Measurement:
        """How recorded motion relates to the model's."""
        length_scale, velocity_lag = self.get_buffer("recorded").tolist()
        return Measurement(length_scale, velocity_lag)

    def dynamics(self, features: Tensor) -> Dynamics:
        """The model's numbers, with gradients, for the transitions whose features (N, n_f) are given."""
        mass, moment, inertia = self.inertia()
        return Dynamics(
            mass=mass,
            moment=moment,
            inertia=inertia,
            corner_pos=self.geometry(),
            mu=self.friction(),
            gravity=torch.tensor([0.0, 0.0, -self.settings.gravity], dtype=torch.float64),
            residual=None if self.residual is None else self.residual(features),
        )

    def terms(self, transitions: Transitions) -> LossTerms:
        """The implicit loss's terms."""
        return implicit_loss(
            transitions,
            self.dynamics(transitions.features),
            corner_body=self.corner_body,
            metric=self._metric,
            weights=self.settings.weights,
        )

    def loss(self, transitions: Transitions) -> tuple[Tensor, dict[str, float]]:
        """Mean loss [m²/s²] and its parts, `unsolved` among them."""
        terms = self.terms(transitions)
        parts: dict[str, Tensor] = {
            "prediction": terms.prediction,
            "complementarity": terms.complementarity,
            "dissipation": terms.dissipation,
            "penetration": terms.penetration,
        }
        if self.residual is not None:
            size = self.residual.rest(transitions.features).square().sum(-1).mean()
            parts["residual"] = self.settings.residual_weight * size
        if self.settings.learn_inertia and self.object.n_joints:
            parts["inertia"] = self.settings.inertia_weight * divergence(self.inertia(), self._metric)
        total = torch.stack(list(parts.values())).sum()
        record = {name: float(value.detach()) for name, value in parts.items()}
        return total, {**record, "unsolved": float(terms.unsolved)}

    def learned_object(self) -> ObjectModel:
        """The object with what was learned in place of what was given."""
        with torch.no_grad():
            mass, moment, at_origin = (part.numpy() for part in self.inertia())
            com = moment / mass[:, None]
            compliance, relaxation, cohesion = self.contact_law()
            shift = np.einsum("bi,bi->b", com, com)[:, None, None] * np.eye(3) - com[:, :, None] * com[:, None, :]
            return self.object.with_changes(
                mass=mass.copy(),
                com=com,
                inertia=at_origin - mass[:, None, None] * shift,
                corner_pos=self.geometry().numpy().copy(),
                friction=float(self.friction()),
                restitution=0.0 if self.settings.learn_contact_law else self.object.restitution,
                compliance=compliance,
                relaxation=relaxation,
                cohesion=cohesion,
            )

    def stages(self, horizons: tuple[int, ...]) -> tuple[str, ...]:
        """Continuous dynamics from flight, contact by the implicit loss, then rollouts."""
        names = [] if self.residual is None else ["continuous"]
        names += ["contact"] if self.settings.implicit else []
        return (*names, *(f"rollout-{horizon}" for horizon in horizons))

    def stage_parameters(self, stage: str) -> list[nn.Parameter]:
        """What a stage learns: rollouts teach few numbers, the implicit loss the corners too."""
        if stage == "continuous":
            return _learned(self.residual, self.inertia)
        if stage == "contact":
            return _learned(self.geometry, self.friction, self.inertia)
        geometry = self.geometry if self.settings.refine_geometry else None
        return _learned(self.friction, self.contact_law, self.inertia, geometry)

    def flight_gravity(self, transitions: Transitions) -> float:
        """Mean downward acceleration in free flight, as the model has it [m/s²]."""
        if self.residual is None or not len(transitions.flight):
            return self.settings.gravity
        flight = transitions.in_flight()
        with torch.no_grad():
            a = free_acceleration(flight, self.dynamics(flight.features))
        return float(-a[:, 2].mean())

    def carried_gravity(self) -> float:
        """Downward acceleration [m/s²] of k_hat and the residual's uniform vertical part: a simulator's gravity."""
        uniform = 0.0 if self.residual is None else SCALE * float(self.residual.vertical.detach())
        return self.settings.gravity - uniform

    def simulator(self) -> Simulator:
        """The learned simulator."""
        return Simulator(self.system())

    def system(self) -> System:
        """The learned simulator's numbers."""
        residual = None if self.residual is None else self.residual.arrays()
        return make_system(self.learned_object(), gravity=self.settings.gravity, residual=residual)

    def parameters_report(self) -> dict[str, Any]:
        """What was learned and what was given, with units."""
        learned, given = self.learned_object(), self.object
        report: dict[str, Any] = {"gravity_given_ms2": self.settings.gravity}
        report["length_scale"] = self.measurement.length_scale
        report["velocity_lag_s"] = self.measurement.velocity_lag
        if self.settings.learn_friction:
            report["friction"] = learned.friction
        if self.settings.learn_contact_law:
            report["stiffness_npm"] = 1 / learned.compliance
            report["relaxation_s"] = learned.relaxation
            report["cohesion_n"] = learned.cohesion
        if self.settings.learn_geometry:
            report["corners_m"] = learned.corner_pos.round(6).tolist()
            report["corner_shift_mm"] = float(1e3 * np.linalg.norm(learned.corner_pos - given.corner_pos, axis=1).max())
        if self.settings.learn_inertia:
            report["com_m"] = learned.com.round(6).tolist()
            report["inertia_kgm2"] = learned.inertia.round(9).tolist()
            report["mass_kg"] = learned.mass.tolist()
        return report


def _learned(*modules: nn.Module | None) -> list[nn.Parameter]:
    return [p for module in modules if module is not None for p in module.parameters() if p.requires_grad]
