"""ContactNets: an object's contact, and on demand its continuous dynamics, learned by the implicit loss.

Sources: Pfrommer, Halm and Posa, "ContactNets", CoRL 2020 (arXiv 2009.11193); Bianchini, Halm and Posa, "Simultaneous
Learning of Contact and Continuous Dynamics", CoRL 2023 (arXiv 2310.12054). What a variant learns is in its settings.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from tossid.models.implicit import Bodies, Dynamics, LossWeights, free_acceleration, implicit_loss
from tossid.models.inertia import divergence, make_inertia
from tossid.models.parameters import ContactLaw, Friction, Geometry, LearnedAccelerationNet
from tossid.models.predictor import Simulator
from tossid.models.protocol import Mechanics, Objective, StagePlan
from tossid.models.random_start import draw_start
from tossid.models.registry import register_model
from tossid.models.transitions import Transitions
from tossid.motion import MeasurementModel
from tossid.objects import ObjectModel
from tossid.physics import ExactCone, PolyhedralCone
from tossid.settings.limits import VALUES
from tossid.settings.training import ModelSettings


class ContactNets(nn.Module):
    """A learnable rigid body (or tree) over the ground.

    Args:
        model: The object as given: the start of everything learned, and the truth of the rest.
        settings: What is learned and given.
        seed: Of the first weights of k_res.
        measurement: How recorded motion relates to the model's; None for exact.
    """

    def __init__(
        self,
        model: ObjectModel,
        settings: ModelSettings,
        *,
        seed: int = 0,
        measurement: MeasurementModel | None = None,
    ) -> None:
        super().__init__()
        measurement = measurement or MeasurementModel()
        recorded = [measurement.length_scale, measurement.velocity_lag]
        self.register_buffer("recorded", torch.tensor(recorded, dtype=torch.float64))
        self.object = model
        self.settings = settings
        self.weights = LossWeights(
            settings.complementarity, settings.dissipation, settings.penetration, settings.gap_scale
        )
        self.corner_body = torch.as_tensor(model.corner_body)
        # corners of a round shape belong together (points of one rim, ends of one axis): they stay as they are
        self.learns_corners = settings.learn_geometry and model.roundness is None
        self.geometry = Geometry(model, learn=self.learns_corners)
        self.friction = Friction(model, learn=settings.learn_friction)
        self.contact_law = ContactLaw(model, learn=settings.learn_contact_law)
        self.inertia = make_inertia(model, kind=settings.inertia, learn=settings.learn_inertia)
        for name, parameter in self.inertia.named_parameters():
            if name in PLACES:
                parameter.requires_grad_(settings.learn_inertia and settings.learn_com)
        self.k_res: LearnedAccelerationNet | None = None
        if settings.learn_k_res:
            generator = torch.Generator().manual_seed(seed)
            self.k_res = LearnedAccelerationNet(
                model.n_joints,
                hidden=settings.hidden,
                generator=generator,
                world=settings.k_res_inputs == "world",
                gravity=settings.k_res_gravity,
            )
        with torch.no_grad():
            self._metric = Bodies(*(part.clone() for part in make_inertia(model, learn=False)()))

    @property
    def measurement(self) -> MeasurementModel:
        """How recorded motion relates to the model's."""
        length_scale, velocity_lag = self.get_buffer("recorded").tolist()
        return MeasurementModel(length_scale, velocity_lag)

    def dynamics(self, a_res: Tensor | None) -> Dynamics:
        """The model's numbers, with gradients.

        Args:
            a_res: (N, nv) the learned acceleration at N transitions; None for none.
        """
        gravity = torch.tensor([0.0, 0.0, -self.settings.gravity], dtype=torch.float64)
        return Dynamics(Bodies(*self.inertia()), self.geometry(), self.friction(), gravity, a_res)

    def loss(self, transitions: Transitions) -> tuple[Tensor, dict[str, float]]:
        """Mean loss [m²/s²] and its parts, `unsolved` among them."""
        features, penalised, a_res = transitions.features, None, None
        if self.k_res is not None:
            penalised = self.k_res.without_vertical(features)
            a_res = self.k_res.with_vertical(penalised, features)
        terms = implicit_loss(
            transitions,
            self.dynamics(a_res),
            corner_body=self.corner_body,
            metric=self._metric,
            weights=self.weights,
            roundness=self.object.roundness,
        )
        parts: dict[str, Tensor] = {name: term for name, term in terms._asdict().items() if name != "unsolved"}
        if penalised is not None:
            parts["k_res"] = self.settings.residual_weight * penalised.square().sum(-1).mean()
        if self.settings.learn_inertia and self.object.n_joints:
            parts["inertia"] = INERTIA_WEIGHT * divergence(self.inertia(), self._metric)
        record = {name: float(value.detach()) for name, value in parts.items()}
        return torch.stack(list(parts.values())).sum(), {**record, "unsolved": float(terms.unsolved)}

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
                friction=min(float(self.friction()), VALUES.friction),
                restitution=0.0 if self.settings.learn_contact_law else self.object.restitution,
                compliance=compliance,
                relaxation=relaxation,
                cohesion=cohesion,
            )

    def stages(self) -> tuple[StagePlan, ...]:
        """Continuous dynamics from flight, contact by the implicit loss, then rollouts over growing horizons.

        The inertia of a rigid body is learned stage by stage: what flight shows of it, then by the implicit loss, then
        by rollouts. Each counts only if validation tosses say so, the last beside rollouts of friction alone. With
        `together` there is one stage of the implicit loss over everything in place of the first two. A stage that has
        nothing to learn is left out.
        """
        if self.settings.together:
            everything = _learned(self.geometry, self.friction, self.inertia, self.k_res)
            plans = [StagePlan("together", Objective.LOSS, everything)]
        else:
            plans = [*self._flight_stages(), *self._contact_stages()]
        return tuple(plan for plan in (*plans, *self._rollout_stages()) if plan.parameters)

    @property
    def _inertia_by_stages(self) -> bool:
        return bool(_learned(self.inertia)) and not self.object.n_joints and not self.settings.together

    def _flight_stages(self) -> list[StagePlan]:
        """Of the body and gravity by the likelihood of flight, then of k_res by the implicit loss in flight."""
        if self.k_res is None:
            return []
        vertical = self.k_res.vertical if self.k_res.gravity else None
        if not self._inertia_by_stages or vertical is None:
            return [
                StagePlan("continuous", Objective.FLIGHT_LOSS, _learned(self.k_res, self.inertia), quadratic=vertical)
            ]
        shown = [*_learned(self.inertia), vertical]
        return [
            StagePlan("flight", Objective.FLIGHT, shown, quadratic=vertical, judged=True),
            StagePlan("continuous", Objective.FLIGHT_LOSS, _learned(self.k_res), quadratic=vertical),
        ]

    def _contact_stages(self) -> list[StagePlan]:
        """Of corners and friction by the implicit loss, and then of these and a rigid body's inertia.

        Between them, friction alone is refined by rollouts: the rival that further freedom has to beat.
        """
        settings, by_stages = self.settings, self._inertia_by_stages
        corners = self.geometry if self.learns_corners else None
        contact = _learned(self.geometry, self.friction, None if by_stages else self.inertia)
        plans = []
        if settings.implicit:
            plans.append(StagePlan("contact", Objective.LOSS, contact, corners=corners))
        if by_stages and settings.horizons:
            law = self.contact_law if settings.learn_contact_law else None
            last = settings.horizons[-1]
            plans.append(
                StagePlan("friction", Objective.ROLLOUT, _learned(self.friction), last, contact_law=law, rival=True)
            )
        if by_stages and settings.implicit:
            everything = _learned(self.geometry, self.friction, self.inertia)
            plans.append(StagePlan("inertia", Objective.LOSS, everything, corners=corners, judged=True))
        return plans

    def _rollout_stages(self) -> list[StagePlan]:
        """Of friction, contact law and inertia, and on demand of corners, by the error of open-loop predictions.

        Objects with joints predict stretches of half the first horizon, and then of the first: a few impacts on, links
        may be anywhere.
        """
        settings, horizons = self.settings, self.settings.horizons
        if self.object.n_joints and horizons:
            horizons = (max(1, horizons[0] // 2), horizons[0])
        geometry = self.geometry if settings.refine_geometry else None
        parameters = _learned(self.friction, self.contact_law, self.inertia, geometry)
        friction = self.friction if settings.learn_friction else None
        law = self.contact_law if settings.learn_contact_law else None
        return [
            StagePlan(f"rollout-{n}", Objective.ROLLOUT, parameters, n, contact_law=law, friction=friction)
            for n in horizons
        ]

    def flight_gravity(self, transitions: Transitions) -> float:
        """Mean downward acceleration in free flight, as the model has it [m/s²]."""
        if self.k_res is None or not len(transitions.flight):
            return self.settings.gravity
        flight = transitions.in_flight()
        with torch.no_grad():
            a = free_acceleration(flight, self.dynamics(self.k_res(flight.features)))
        return float(-a[:, 2].mean())

    def mechanics(self) -> Mechanics:
        """The model as rigid bodies with contact."""
        net, gravity = self.k_res, self.settings.gravity
        if net is None:
            return Mechanics(self.learned_object(), gravity, weights=self.weights)
        return Mechanics(self.learned_object(), gravity, net.arrays(), net.uniform_vertical(), self.weights)

    def simulator(self) -> Simulator:
        """The learned simulator."""
        cone = {"exact": ExactCone(), "polyhedral": PolyhedralCone()}[self.settings.cone]
        steps = {"substeps": self.settings.substeps, "impact_parts": self.settings.impact_parts}
        return Simulator(self.mechanics().system(), **steps, solver=cone)

    def parameters_report(self) -> dict[str, Any]:
        """What was learned and what was given, with units."""
        learned, given = self.learned_object(), self.object
        report: dict[str, Any] = {"gravity_given_ms2": self.settings.gravity}
        report["length_scale"] = self.measurement.length_scale
        report["velocity_lag_s"] = self.measurement.velocity_lag
        if self.settings.learn_friction:
            report["friction"] = learned.friction
        if self.settings.learn_contact_law:
            if learned.compliance > 0.0:  # contact is not rigid
                report["stiffness_npm"] = 1 / learned.compliance
                report["relaxation_s"] = learned.relaxation
            report["cohesion_n"] = learned.cohesion
        if self.learns_corners:
            report["corners_m"] = learned.corner_pos.round(6).tolist()
            report["corner_shift_mm"] = float(1e3 * np.linalg.norm(learned.corner_pos - given.corner_pos, axis=1).max())
        if self.settings.learn_inertia:
            report["com_m"] = learned.com.round(6).tolist()
            report["inertia_kgm2"] = learned.inertia.round(9).tolist()
            report["mass_kg"] = learned.mass.tolist()
        return report


def build(
    settings: ModelSettings, given: ObjectModel, *, seed: int = 0, measurement: MeasurementModel | None = None
) -> ContactNets:
    """The untrained model, at the start that the settings ask for.

    Args:
        settings: What is learned and given, and how far the start is from the given object.
        given: The object as it is stated.
        seed: Of the corners' offsets and of the first weights of k_res.
        measurement: How recorded motion relates to the model's; None for exact.
    """
    com = given.com.copy()
    com[0] += settings.start_com
    rng = np.random.default_rng(seed)
    off = rng.normal(size=given.corner_pos.shape) * settings.start_corners
    if settings.random_start:
        given, _ = draw_start(given, rng, inertia=settings.learn_inertia)
    start = given.with_changes(
        inertia=settings.start_inertia * given.inertia, com=com, corner_pos=given.corner_pos + off
    )
    return ContactNets(start, settings, seed=seed, measurement=measurement)


def _learned(*modules: nn.Module | None) -> list[nn.Parameter]:
    return [p for module in modules if module is not None for p in module.parameters() if p.requires_grad]


INERTIA_WEIGHT = 2e-4
"""Weight of a tree's divergence from the given inertia [m²/s²]. Without it the implicit loss prefers light links, which
hardly constrain it: with real tosses a link went from 0.37 kg to 0.2 g. Rollouts have no such term."""
PLACES = ("com", "log_scale_links", "log_mass_links")
"""Parameters of inertia that decide where the common centre of mass is: each link's, and the mass ratio."""

register_model("contactnets", ModelSettings, build)
