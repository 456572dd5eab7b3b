"""Effects of contact: friction, resistance to spin, bouncing, yielding and adhesion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from tossid.physics.effects.changes import half_size, sets_law, with_object
from tossid.physics.effects.effect import CONTACT_PHASES, Effect, InMujoco, MjcfEdit, NotExpressible, Parameter
from tossid.physics.effects.mjcf_edit import Edit
from tossid.physics.effects.mujoco_contact import contact_pair, write_compliance, write_friction, write_restitution
from tossid.physics.effects.strength import Strength, between, plain, scaled, sign_of
from tossid.physics.effects.world import World

TYPICAL_FRICTION, TYPICAL_MASS = 0.18, 0.37
"""Coefficient about which an audit's frictions are drawn, and mass [kg] for which its dampers are."""
NO_SPEED = NotExpressible("MuJoCo's friction does not depend on speed", lambda world: world.law.static_rel != 1.0)
NO_COHESION = NotExpressible(
    "MuJoCo's friction is in proportion to the load", lambda world: world.object.cohesion != 0.0
)
NO_ADHESION = NotExpressible(
    "MuJoCo's adhesion holds against a pull, and takes most of its friction from what slides",
    lambda world: world.law.adhesion != 0.0,
)


def _velocity_friction(world: World, p: Mapping[str, float]) -> World:
    law = world.law._replace(static_rel=p["static_mu"] / p["sliding_mu"], slip_speed=p["speed_ms"])
    return replace(with_object(world, friction=p["sliding_mu"]), law=law)


def _anisotropic(world: World, p: Mapping[str, float]) -> World:
    return replace(with_object(world, friction=p["x_mu"]), law=world.law._replace(y_rel=p["y_mu"] / p["x_mu"]))


def _compliance(world: World, p: Mapping[str, float]) -> World:
    """A corner's spring and damper, as felt by what moves; of a load, an impedance D holds the share D at once.

    As a step's reference in MuJoCo, contact cancels D of what else accelerates the corner: it has D / (1 - D) of the
    object's mass added to it, and D = 0 is the plain spring.
    """
    stiffness, left = p["stiffness_npm"], 1.0 - p["impedance_rel"]
    softer = with_object(world, compliance=left / stiffness, relaxation=p["damping_nspm"] / stiffness, restitution=0.0)
    added = float(world.object.mass.sum()) * p["impedance_rel"] / left
    return replace(softer, law=world.law._replace(added_mass=added))


def _velocity_friction_of_size(size: float, u: np.ndarray) -> dict[str, float]:
    return {
        "static_mu": TYPICAL_FRICTION * math.exp(size),
        "sliding_mu": TYPICAL_FRICTION * math.exp(-0.5 * size),
        "speed_ms": between(0.1, 0.6, u[1]),
    }


def _anisotropic_of_size(size: float, u: np.ndarray) -> dict[str, float]:
    return {
        "x_mu": TYPICAL_FRICTION * math.exp(sign_of(u) * size),
        "y_mu": TYPICAL_FRICTION * math.exp(-sign_of(u) * size),
    }


def _compliance_of_size(size: float, u: np.ndarray) -> dict[str, float]:
    stiffness = 1 / size
    return {
        "stiffness_npm": stiffness,
        "damping_nspm": 2 * between(0.1, 0.8, u[1]) * math.sqrt(stiffness * TYPICAL_MASS),
        "impedance_rel": max(0.0, 0.95 * float(u[2])),  # none in half of the cases
    }


def _resist_spin(compiled: Any, world: World) -> None:
    """MuJoCo's own torsional and rolling friction, of contacts of 4 or 6 dimensions.

    They share one cone with friction there, so that a sliding contact resists turning less than a resting one.
    """
    law = world.law
    if law.torsional > 0 or law.rolling > 0:
        dimensions = 6 if law.rolling > 0 else 4
        compiled.geom_condim[:], compiled.pair_dim[:] = dimensions, dimensions
        compiled.geom_friction[:, 1:] = law.torsional, law.rolling
        compiled.pair_friction[:, 2], compiled.pair_friction[:, 3:] = law.torsional, law.rolling


def _write_anisotropic(edit: Edit, before: World, after: World) -> None:
    """Friction along the plane's two axes: for a level plane, world y and x."""
    pair = contact_pair(edit, before)
    if pair is not None:
        x, y = after.object.friction, after.object.friction * after.law.y_rel
        edit.set(pair, "friction", [y, x, *np.array(pair.friction)[2:]], "contact pair", note="along y, then along x")


FRICTION = Effect(
    name="friction",
    family="contact",
    says="the coefficient of friction differs",
    parameters=(Parameter("mu", None, 0.005, 2.0, 5e-3),),
    phases=CONTACT_PHASES,
    apply=lambda world, p: with_object(world, friction=p["mu"]),
    read=lambda world: {"mu": world.object.friction},
    mujoco=InMujoco(),
    mjcf=MjcfEdit(write_friction),
    strength=Strength(0.05, 1.5, scaled("mu", TYPICAL_FRICTION)),
    starts=({"mu": 0.08}, {"mu": 0.35}, {"mu": 0.8}),
)

VELOCITY_FRICTION = Effect(
    name="velocity_friction",
    family="contact",
    says="friction depends on the speed of sliding",
    parameters=(
        Parameter("static_mu", None, 0.005, 2.0, 5e-3),
        Parameter("sliding_mu", None, 0.005, 2.0, 5e-3),
        Parameter("speed_ms", 0.2, 0.01, 3.0, 0.02, form=True),
    ),
    phases=CONTACT_PHASES,
    apply=_velocity_friction,
    read=lambda world: {"static_mu": world.object.friction, "sliding_mu": world.object.friction},
    mujoco=NO_SPEED,
    mjcf=NO_SPEED,
    strength=Strength(0.15, 1.5, _velocity_friction_of_size),
    contains=("friction",),
    starts=tuple(
        {"static_mu": static, "sliding_mu": sliding, "speed_ms": speed}
        for static, sliding, speed in ((0.3, 0.15, 0.2), (0.1, 0.25, 0.4), (0.5, 0.12, 0.3))
    ),
)

ANISOTROPIC_FRICTION = Effect(
    name="anisotropic_friction",
    family="contact",
    says="friction differs with direction",
    parameters=tuple(Parameter(f"{a}_mu", None, 0.005, 2.0, 5e-3) for a in "xy"),
    phases=CONTACT_PHASES,
    apply=_anisotropic,
    read=lambda world: {"x_mu": world.object.friction, "y_mu": world.object.friction},
    mujoco=NotExpressible("its axes are the world's, MuJoCo's are the contact's", lambda world: world.law.y_rel != 1.0),
    mjcf=MjcfEdit(_write_anisotropic),
    strength=Strength(0.1, 1.2, _anisotropic_of_size),
    contains=("friction",),
    starts=tuple({"x_mu": x, "y_mu": y} for x, y in ((0.1, 0.3), (0.3, 0.1), (0.07, 0.5), (0.5, 0.07))),
)

COHESION = Effect(
    name="cohesion",
    family="contact",
    says="friction keeps a part that does not depend on the load",
    parameters=(Parameter("c_n", 0.0, 0.0, 2.0, 5e-3),),
    phases=CONTACT_PHASES,
    apply=lambda world, p: with_object(world, cohesion=p["c_n"]),
    mujoco=NO_COHESION,
    mjcf=NO_COHESION,
    strength=Strength(0.01, 1.5, plain("c_n")),
    starts=({"c_n": 0.1}, {"c_n": 0.4}, {"c_n": 1.2}),
)

TORSIONAL_FRICTION = Effect(
    name="torsional_friction",
    family="contact",
    says="a contact resists spin about the vertical",
    parameters=(Parameter("radius_m", 0.0, 0.0, 0.1, 1e-3, limit=half_size),),
    phases=CONTACT_PHASES,
    apply=sets_law(torsional="radius_m"),
    mujoco=InMujoco(scene=_resist_spin),
    mjcf=MjcfEdit(write_friction),
    strength=Strength(2e-3, 0.08, plain("radius_m")),
    starts=({"radius_m": 0.01}, {"radius_m": 0.04}),
)

ROLLING_RESISTANCE = Effect(
    name="rolling_resistance",
    family="contact",
    says="a contact resists rolling",
    parameters=(Parameter("radius_m", 0.0, 0.0, 0.1, 1e-3, limit=half_size),),
    phases=CONTACT_PHASES,
    apply=sets_law(rolling="radius_m"),
    mujoco=InMujoco(scene=_resist_spin),
    mjcf=MjcfEdit(write_friction),
    strength=Strength(5e-4, 0.05, plain("radius_m")),
    starts=({"radius_m": 0.003}, {"radius_m": 0.02}),
)

RESTITUTION = Effect(
    name="restitution",
    family="contact",
    says="impacts bounce",
    parameters=(Parameter("e", None, 0.0, 0.95, 0.02),),
    phases=CONTACT_PHASES,
    apply=lambda world, p: with_object(world, restitution=p["e"], compliance=0.0, relaxation=0.0),
    read=lambda world: {"e": world.object.restitution},
    mujoco=InMujoco(),
    mjcf=MjcfEdit(write_restitution),
    strength=Strength(0.04, 0.7, plain("e")),
    starts=({"e": 0.15}, {"e": 0.3}, {"e": 0.45}, {"e": 0.65}),
)

STARTS_OF_COMPLIANCE = (
    *((6e4, 120.0, 0.0), (2e4, 60.0, 0.0), (2e4, 15.0, 0.0), (5e3, 30.0, 0.0), (5e3, 8.0, 0.0), (1.5e3, 10.0, 0.0)),
    *((2.5e4, 185.0, 0.98), (4e3, 75.0, 0.93), (1e3, 37.0, 0.93)),
)
"""Stiffness, damping and impedance: plain springs first, then contact as MuJoCo has it."""

COMPLIANCE = Effect(
    name="compliance",
    family="contact",
    says="contact yields like a spring and a damper, or, with an impedance, like MuJoCo's",
    parameters=(
        Parameter("stiffness_npm", 2e5, 50.0, 5e5, 1e3),
        Parameter("damping_nspm", 100.0, 0.0, 1e3, 2.0, form=True),
        Parameter("impedance_rel", 0.0, 0.0, 0.995, 0.01, form=True),
    ),
    phases=CONTACT_PHASES,
    apply=_compliance,
    mujoco=InMujoco(),
    mjcf=MjcfEdit(write_compliance, of_links=NotExpressible("each link needs a contact pair of its own")),
    strength=Strength(1e-5, 1e-3, _compliance_of_size),
    near_nothing=True,  # rigid contact is infinitely stiff
    starts=tuple(
        {"stiffness_npm": k, "damping_nspm": d, "impedance_rel": impedance} for k, d, impedance in STARTS_OF_COMPLIANCE
    ),
)

ADHESION = Effect(
    name="adhesion",
    family="contact",
    says="the ground holds on to what touches it",
    parameters=(Parameter("force_n", 0.0, 0.0, 10.0, 0.02),),
    phases=CONTACT_PHASES,
    apply=sets_law(adhesion="force_n"),
    mujoco=NO_ADHESION,
    mjcf=NO_ADHESION,
    strength=Strength(0.02, 3.0, plain("force_n")),
    starts=({"force_n": 0.3}, {"force_n": 2.0}),
)

EFFECTS = (
    FRICTION,
    VELOCITY_FRICTION,
    ANISOTROPIC_FRICTION,
    COHESION,
    TORSIONAL_FRICTION,
    ROLLING_RESISTANCE,
    RESTITUTION,
    COMPLIANCE,
    ADHESION,
)
"""The family, in the order in which its effects are fitted and drawn."""
