"""The library of effects: what may be missing in a simulator, each declared once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from tossid.physics.effects.effect import Effect, Parameter
from tossid.physics.effects.world import World
from tossid.physics.forces import DRAG, MAGNUS, SPIN, SPRING, TURNING, VORTEX
from tossid.types import Phase

FLIGHT, IMPACT, SLIDE, ROLL, REST = Phase.FLIGHT, Phase.IMPACT, Phase.SLIDE, Phase.ROLL, Phase.REST
ALL = (FLIGHT, IMPACT, SLIDE, ROLL, REST)
CONTACT = (IMPACT, SLIDE, ROLL, REST)

LEAST_DRAG = 0.02
"""[N s/m] that wind is searched from in a world without drag."""


def _body(world: World, **changes: object) -> World:
    return replace(world, object=world.object.with_changes(**changes))


def _com_offset(world: World, p: Mapping[str, float]) -> World:
    com = world.object.com.copy()
    com[0] += [p["x_m"], p["y_m"], p["z_m"]]
    return _body(world, com=com)


def _forces(**names: str) -> Callable[[World, Mapping[str, float]], World]:
    """An effect whose parameters are numbers of `Forces`."""
    return lambda world, p: replace(world, forces=world.forces._replace(**{k: p[n] for k, n in names.items()}))


def _law(**names: str) -> Callable[[World, Mapping[str, float]], World]:
    return lambda world, p: replace(world, law=world.law._replace(**{k: p[n] for k, n in names.items()}))


def _compliance(world: World, p: Mapping[str, float]) -> World:
    """A corner's spring and damper, as felt by what moves; of a load, an impedance D holds the share D at once.

    As a step's reference in MuJoCo, contact cancels D of what else accelerates the corner: it has D / (1 - D) of the
    object's mass added to it, and D = 0 is the plain spring.
    """
    stiffness, left = p["stiffness_npm"], 1.0 - p["impedance_rel"]
    softer = _body(world, compliance=left / stiffness, relaxation=p["damping_nspm"] / stiffness, restitution=0.0)
    added = float(world.object.mass.sum()) * p["impedance_rel"] / left
    return replace(softer, law=world.law._replace(added_mass=added))


def _restitution(world: World, p: Mapping[str, float]) -> World:
    return _body(world, restitution=p["e"], compliance=0.0, relaxation=0.0)


def _anisotropic(world: World, p: Mapping[str, float]) -> World:
    return replace(_body(world, friction=p["x_mu"]), law=world.law._replace(y_rel=p["y_mu"] / p["x_mu"]))


def _velocity_friction(world: World, p: Mapping[str, float]) -> World:
    law = world.law._replace(static_rel=p["static_mu"] / p["sliding_mu"], slip_speed=p["speed_ms"])
    return replace(_body(world, friction=p["sliding_mu"]), law=law)


def _recording(world: World, **changes: object) -> World:
    return replace(world, recording=replace(world.recording, **changes))  # type: ignore[arg-type]


def _mu(world: World) -> float:
    return world.object.friction


LIBRARY: tuple[Effect, ...] = (
    Effect(
        "com_offset",
        "body",
        tuple(Parameter(f"{a}_m", 0.0, -0.04, 0.04, 1e-3) for a in "xyz"),
        ALL,
        "the centre of mass is not where the object's model has it",
        _com_offset,
    ),
    Effect(
        "inertia",
        "body",
        (Parameter("scale_rel", 1.0, 0.2, 5.0, 0.03),),
        CONTACT,
        "the moments of inertia are larger or smaller than stated",
        lambda w, p: _body(w, inertia=p["scale_rel"] * w.object.inertia),
        starts=tuple({"scale_rel": scale} for scale in (0.45, 0.7, 0.88, 1.14, 1.5, 2.0)),
    ),
    Effect(
        "geometry",
        "body",
        (Parameter("size_rel", 1.0, 0.8, 1.25, 2e-3),),
        CONTACT,
        "the object is larger or smaller than stated",
        lambda w, p: _body(w, corner_pos=p["size_rel"] * w.object.corner_pos),
        starts=tuple({"size_rel": size} for size in (0.93, 0.965, 0.99, 1.01, 1.035, 1.07)),
    ),
    Effect(
        "rounded_corners",
        "body",
        (Parameter("radius_m", 0.0, 0.0, 0.025, 5e-4),),
        CONTACT,
        "corners and edges are rounded",
        _law(rounding="radius_m"),
        starts=({"radius_m": 0.002}, {"radius_m": 0.008}),
    ),
    Effect(
        "gravity",
        "environment",
        (Parameter("g_ms2", None, 0.0, 25.0, 0.05),),
        ALL,
        "gravity differs from the simulator's",
        lambda w, p: replace(w, gravity=p["g_ms2"]),
        lambda w: {"g_ms2": w.gravity},
    ),
    Effect(
        "ground_tilt",
        "environment",
        tuple(Parameter(f"{a}_rad", 0.0, -0.2, 0.2, 2e-3) for a in "xy"),
        CONTACT,
        "the ground is not level",
        lambda w, p: replace(w, ground_tilt=(p["x_rad"], p["y_rad"])),
    ),
    Effect(
        "ground_height",
        "environment",
        (Parameter("z_m", 0.0, -0.05, 0.05, 5e-4),),
        CONTACT,
        "the ground is not at z = 0",
        lambda w, p: replace(w, ground_height=p["z_m"]),
        starts=tuple({"z_m": z} for z in (-8e-3, -2e-3, 2e-3, 8e-3)),
    ),
    Effect(
        "linear_drag",
        "fluid",
        (Parameter("c_nspm", 0.0, 0.0, 2.0, 5e-3),),
        ALL,
        "a resistance in proportion to speed",
        _forces(linear="c_nspm"),
    ),
    Effect(
        "quadratic_drag",
        "fluid",
        (Parameter("c_ns2pm2", 0.0, 0.0, 2.0, 5e-3),),
        ALL,
        "a resistance in proportion to speed squared, as air's",
        _forces(quadratic="c_ns2pm2"),
    ),
    Effect(
        "spin_drag",
        "fluid",
        (Parameter("c_nms", 0.0, 0.0, 0.02, 2e-5),),
        ALL,
        "a torque against spin",
        _forces(spin="c_nms"),
    ),
    Effect(
        "wind",
        "fluid",
        (*(Parameter(f"{a}_ms", 0.0, -10.0, 10.0, 0.2) for a in "xy"), Parameter("c_nspm", None, 1e-3, 1.0, 5e-3)),
        ALL,
        "moving air",
        _forces(wind_x="x_ms", wind_y="y_ms", linear="c_nspm"),
        lambda w: {"c_nspm": w.forces.linear or LEAST_DRAG},
        contains=("linear_drag",),
    ),
    Effect(
        "magnus",
        "fluid",
        (Parameter("c_ns2pm", 0.0, -0.1, 0.1, 1e-3),),
        ALL,
        "a sideways force of a spinning body in air",
        _forces(magnus="c_ns2pm"),
    ),
    Effect(
        "uniform_force",
        "field",
        tuple(Parameter(f"{a}_n", 0.0, -5.0, 5.0, 0.02) for a in "xyz"),
        ALL,
        "a constant force",
        _forces(x="x_n", y="y_n", z="z_n"),
        contains=("gravity",),
    ),
    Effect(
        "position_force",
        "field",
        (
            Parameter("k_npm", 0.0, 0.0, 50.0, 0.1),
            *(Parameter(f"{a}_m", 0.0, -2.0, 2.0, 0.05) for a in "xyz"),
        ),
        ALL,
        "a pull towards a point, as of a spring or a magnet",
        _forces(spring="k_npm", center_x="x_m", center_y="y_m", center_z="z_m"),
        contains=("uniform_force", "gravity"),
        starts=({"k_npm": 0.5}, {"k_npm": 5.0}),
    ),
    Effect(
        "vortex",
        "field",
        (Parameter("c_npm", 0.0, -20.0, 20.0, 0.05),),
        ALL,
        "a force around the world's vertical axis, in proportion to the distance from it",
        _forces(vortex="c_npm"),
    ),
    Effect(
        "turning_frame",
        "field",
        (Parameter("rate_ps", 0.0, -5.0, 5.0, 0.02),),
        ALL,
        "a sideways acceleration in proportion to velocity, as in a turning frame",
        _forces(turning="rate_ps"),
    ),
    Effect(
        "friction",
        "contact",
        (Parameter("mu", None, 0.005, 2.0, 5e-3),),
        CONTACT,
        "the coefficient of friction differs",
        lambda w, p: _body(w, friction=p["mu"]),
        lambda w: {"mu": _mu(w)},
        starts=({"mu": 0.08}, {"mu": 0.35}, {"mu": 0.8}),
    ),
    Effect(
        "velocity_friction",
        "contact",
        (
            Parameter("static_mu", None, 0.005, 2.0, 5e-3),
            Parameter("sliding_mu", None, 0.005, 2.0, 5e-3),
            Parameter("speed_ms", 0.2, 0.01, 3.0, 0.02),
        ),
        CONTACT,
        "friction depends on the speed of sliding",
        _velocity_friction,
        lambda w: {"static_mu": _mu(w), "sliding_mu": _mu(w)},
        contains=("friction",),
        starts=(
            {"static_mu": 0.3, "sliding_mu": 0.15, "speed_ms": 0.2},
            {"static_mu": 0.1, "sliding_mu": 0.25, "speed_ms": 0.4},
            {"static_mu": 0.5, "sliding_mu": 0.12, "speed_ms": 0.3},
        ),
    ),
    Effect(
        "anisotropic_friction",
        "contact",
        tuple(Parameter(f"{a}_mu", None, 0.005, 2.0, 5e-3) for a in "xy"),
        CONTACT,
        "friction differs with direction",
        _anisotropic,
        lambda w: {"x_mu": _mu(w), "y_mu": _mu(w)},
        contains=("friction",),
        starts=(
            {"x_mu": 0.1, "y_mu": 0.3},
            {"x_mu": 0.3, "y_mu": 0.1},
            {"x_mu": 0.07, "y_mu": 0.5},
            {"x_mu": 0.5, "y_mu": 0.07},
        ),
    ),
    Effect(
        "cohesion",
        "contact",
        (Parameter("c_n", 0.0, 0.0, 2.0, 5e-3),),
        CONTACT,
        "friction keeps a part that does not depend on the load",
        lambda w, p: _body(w, cohesion=p["c_n"]),
        starts=({"c_n": 0.1}, {"c_n": 0.4}, {"c_n": 1.2}),
    ),
    Effect(
        "torsional_friction",
        "contact",
        (Parameter("radius_m", 0.0, 0.0, 0.1, 1e-3),),
        CONTACT,
        "a contact resists spin about the vertical",
        _law(torsional="radius_m"),
        starts=({"radius_m": 0.01}, {"radius_m": 0.04}),
    ),
    Effect(
        "rolling_resistance",
        "contact",
        (Parameter("radius_m", 0.0, 0.0, 0.1, 1e-3),),
        CONTACT,
        "a contact resists rolling",
        _law(rolling="radius_m"),
        starts=({"radius_m": 0.003}, {"radius_m": 0.02}),
    ),
    Effect(
        "restitution",
        "contact",
        (Parameter("e", None, 0.0, 0.95, 0.02),),
        CONTACT,
        "impacts bounce",
        _restitution,
        lambda w: {"e": w.object.restitution},
        starts=({"e": 0.15}, {"e": 0.3}, {"e": 0.45}, {"e": 0.65}),
    ),
    Effect(
        "compliance",
        "contact",
        (
            Parameter("stiffness_npm", 2e5, 50.0, 5e5, 1e3),
            Parameter("damping_nspm", 100.0, 0.0, 1e3, 2.0),
            Parameter("impedance_rel", 0.0, 0.0, 0.995, 0.01),
        ),
        CONTACT,
        "contact yields like a spring and a damper, or, with an impedance, like MuJoCo's",
        _compliance,
        starts=tuple(
            {"stiffness_npm": k, "damping_nspm": d, "impedance_rel": impedance}
            for k, d, impedance in (
                (6e4, 120.0, 0.0),
                (2e4, 60.0, 0.0),
                (2e4, 15.0, 0.0),
                (5e3, 30.0, 0.0),
                (5e3, 8.0, 0.0),
                (1.5e3, 10.0, 0.0),
                (2.5e4, 185.0, 0.98),
                (4e3, 75.0, 0.93),
                (1e3, 37.0, 0.93),
            )
        ),
    ),
    Effect(
        "adhesion",
        "contact",
        (Parameter("force_n", 0.0, 0.0, 10.0, 0.02),),
        CONTACT,
        "the ground holds on to what touches it",
        _law(adhesion="force_n"),
        starts=({"force_n": 0.3}, {"force_n": 2.0}),
    ),
    Effect(
        "length_scale",
        "measurement",
        (Parameter("scale_rel", 1.0, 0.7, 1.4, 1e-3),),
        ALL,
        "recorded lengths are too short or too long",
        lambda w, p: _recording(w, length_scale=p["scale_rel"]),
    ),
    Effect(
        "time_base",
        "measurement",
        (Parameter("rate_rel", 1.0, 0.7, 1.4, 1e-3),),
        ALL,
        "the recording's clock is too fast or too slow",
        lambda w, p: _recording(w, clock_rate=p["rate_rel"]),
    ),
    Effect(
        "body_frame_offset",
        "measurement",
        tuple(Parameter(f"{a}_m", 0.0, -0.05, 0.05, 5e-4) for a in "xyz"),
        ALL,
        "the recorded frame does not sit where the object's frame is",
        lambda w, p: _recording(w, frame_offset=(p["x_m"], p["y_m"], p["z_m"])),
    ),
    Effect(
        "world_tilt",
        "measurement",
        tuple(Parameter(f"{a}_rad", 0.0, -0.2, 0.2, 2e-3) for a in "xy"),
        ALL,
        "the recorded world is tilted against the vertical",
        lambda w, p: _recording(w, world_tilt=(p["x_rad"], p["y_rad"])),
    ),
)

NEVER_NOTHING = ("wind", "compliance")
"""Effects whose nominal values only stand near nothing."""

POWER = "power"

_STATES = {
    "linear_drag": (DRAG, "speed"),
    "quadratic_drag": (DRAG, "speed"),
    "wind": (DRAG, "speed in the wind"),
    "spin_drag": (SPIN, "spin"),
    "magnus": (MAGNUS, "spin"),
    "position_force": (SPRING, "distance"),
    "vortex": (VORTEX, "distance from the axis"),
    "turning_frame": (TURNING, "speed"),
}


def _other_power(name: str, which: int, state: str) -> Effect:
    return Effect(
        f"{name}'s power",
        "law",
        (Parameter(POWER, 0.0, -2.0, 4.0, 0.1),),
        (FLIGHT,),
        state,
        lambda w, p: replace(w, forces=w.forces._replace(powered=float(which), power=p[POWER])),
    )


OTHER_LAWS: dict[str, Effect] = {name: _other_power(name, *state) for name, state in _STATES.items()}
"""By what further power of its state (`says`) the force of an effect grows: whether it has the effect's law at all.
They are not of the library, and are never named."""
