"""Convex objects of several kinds, tossed by an engine, as tracked poses: data for learning objects from nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from tossid.objects import GRAVITY, ObjectModel, object_from_mjcf
from tossid.objects.roundness import Roundness, directions, disc
from tossid.physics.effects import World
from tossid.rotations import quat_exp, quat_mul, quat_to_matrix
from tossid.settings.kinds import Checked, Count, NonNegative, Positive, Seed
from tossid.settings.synthesis import LcpEngine, MujocoEngine
from tossid.synthesis.engines import ENGINES
from tossid.types import PoseTrack

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ShapeTossSettings(Checked):
    """Tosses of convex shapes, from which they are learned anew."""

    engine: Literal["mujoco", "lcp"] = "mujoco"
    """mujoco; lcp: tossid's own, with rigid contact and Coulomb's friction"""
    tosses: Count = 60
    """how many"""
    mass: Positive = 0.3
    """of the object [kg]"""
    friction: NonNegative = 0.25
    """Coulomb's"""
    frames: Count = 180
    """most frames of a toss"""
    step: Positive = 5e-5
    """MuJoCo's time step [s], with which contact is near rigid"""
    seed: Seed = 0
    """of what is drawn"""


class TossedShape(NamedTuple):
    """An object that was tossed, with its truth in the recorded body frame.

    Attributes:
        name: Of the shape.
        tracks: Tracked poses, with noise.
        truth: The same without noise.
        hull: (n, 3) points of the shape's hull; vertices of a polytope, many points of a round one [m].
        object: The object that was tossed, in its recorded frame.
    """

    name: str
    tracks: tuple[PoseTrack, ...]
    truth: tuple[PoseTrack, ...]
    hull: Array
    object: ObjectModel


def _row(values: Array) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def _irregular() -> Array:
    """Twelve points, each a vertex that stands out from the hull of the others."""
    rng = np.random.default_rng(12)
    while True:
        points = np.array([0.055, 0.045, 0.04]) * directions(12) * rng.uniform(0.92, 1.12, (12, 1))
        if len(ConvexHull(points).vertices) == 12:
            return points


def _rounded_disc(radius: float, edge: float, rim: int = 120, around: int = 25) -> Array:
    """Points of a disc of some radius [m], every point of which is a ball of radius `edge` [m]."""
    angle, lean = np.linspace(0, 2 * np.pi, rim, endpoint=False), np.linspace(-np.pi / 2, np.pi / 2, around)
    a, b = (x.ravel() for x in np.meshgrid(angle, lean))
    r = radius + edge * np.cos(b)
    return np.column_stack([r * np.cos(a), r * np.sin(a), edge * np.sin(b)])


DISC = (0.045, 0.01)
"""Radius of the disc, and of the ball at each of its points [m]."""
ELLIPSOID = np.array([0.06, 0.045, 0.035])
"""Half axes of the ellipsoid [m]."""


def _shapes() -> Mapping[str, tuple[Array, str | None]]:
    """Points of each shape's hull about its frame [m], and the MJCF geom of one that is no mesh."""
    ring = np.linspace(0, 2 * np.pi, 6, endpoint=False)
    prism = np.concatenate(
        [np.column_stack([0.045 * np.cos(ring), 0.045 * np.sin(ring), np.full(6, z)]) for z in (-0.03, 0.03)]
    )
    wedge = np.array([[x, y, z] for y in (-0.04, 0.04) for x, z in ((-0.05, -0.02), (0.05, -0.02), (-0.05, 0.04))])
    tetrahedron = 0.065 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    base = 0.05 * np.array([[-1, -1, -0.4], [1, -1, -0.4], [-1, 1, -0.4], [1, 1, -0.4], [0, 0, 1.2]])
    ball, rim = directions(1000), np.linspace(0, 2 * np.pi, 240, endpoint=False)
    circle = 0.04 * np.column_stack([np.cos(rim), np.sin(rim), np.zeros(240)])
    return {
        "tetrahedron": (tetrahedron, None),
        "wedge": (wedge, None),
        "hexagonal prism": (prism, None),
        "irregular polytope": (_irregular(), None),
        "ellipsoid": (ELLIPSOID * directions(2000), f'type="ellipsoid" size="{_row(ELLIPSOID)}"'),
        "rounded disc": (_rounded_disc(*DISC), None),
        "octahedron": (np.array([0.05, 0.06, 0.045]) * np.concatenate([np.eye(3), -np.eye(3)]), None),
        "slab": (signs * [0.06, 0.04, 0.012], None),
        "rod": (signs * [0.09, 0.018, 0.015], None),
        "box": (signs * [0.05, 0.04, 0.03], None),
        "pyramid": (base, None),
        "sphere": (0.04 * directions(2000), 'type="sphere" size="0.04"'),
        "capsule": (_ends(0.025 * ball, 0.04), 'type="capsule" size="0.025 0.04"'),
        "cylinder": (_ends(circle, 0.03), 'type="cylinder" size="0.04 0.03"'),
    }


def _ends(points: Array, half: float) -> Array:
    """Points at both ends of an axis along z of some half length [m]."""
    return np.concatenate([points + np.array([0.0, 0.0, z]) for z in (-half, half)])


SHAPES = tuple(_shapes())
"""The shapes by name."""
ROUND: Mapping[str, Roundness] = {"rounded disc": disc(DISC[0], [0.0, 0.0, 1.0], edge=DISC[1])}
"""What stands at the middle of shapes whose meshes only stand for something round."""
FRAME_OFFSET = np.array([0.012, -0.02, 0.007])
"""Where the shape's middle is in the recorded body frame [m]."""
HEIGHT, SPEED, SPIN = 0.25, 1.0, 6.0
"""Of releases: the lowest point [m], the largest horizontal speed along each axis [m/s], and the standard deviation of
the spin along each axis [rad/s]."""
NOISE, NOISE_RAD = 1.5e-4, 2e-3
"""Standard deviations of recorded positions [m], as of the published cube's, and of recorded rotations [rad]."""
RATE_HZ = 148.0
STILL, REST_FRAMES = 0.02, 10
"""Largest velocity of a body at rest [m/s, rad/s], and the frames at rest after which a toss ends."""


def toss_shape(name: str, settings: ShapeTossSettings | None = None) -> TossedShape:
    """Tosses of a shape of `SHAPES`; the settings say how many and how noisy.

    The body's frame lies off the shape's middle and off its centre of mass, as a tracker's does.
    """
    settings = settings or ShapeTossSettings()
    points, geom = _shapes()[name]
    mesh = "" if geom is not None else f'<mesh name="m" inertia="exact" vertex="{_row(points.ravel())}"/>'
    geom = geom or 'type="mesh" mesh="m"'
    text = f"""<mujoco model="{name}">
  <asset>{mesh}</asset>
  <worldbody>
    <body name="{name}">
      <freejoint/>
      <geom name="hull" {geom} pos="{_row(FRAME_OFFSET)}" mass="{settings.mass}"/>
    </body>
  </worldbody>
</mujoco>"""
    hull = points + FRAME_OFFSET
    if mesh:
        hull = hull[ConvexHull(hull).vertices]
    shape = object_from_mjcf(text, friction=settings.friction)
    if name in ROUND:
        count = len(ROUND[name].radius)
        corners = np.tile(FRAME_OFFSET, (count, 1))
        bodies = np.zeros(count, dtype=np.int64)
        shape = shape.with_changes(corner_body=bodies, corner_pos=corners, roundness=ROUND[name])

    def lowest(q: Array) -> float:
        return float((quat_to_matrix(q[3:7])[2] @ hull.T).min())

    rng = np.random.default_rng([settings.seed, SHAPES.index(name)])
    truth = toss(shape, lowest, rng, settings)
    return TossedShape(name, tuple(noisy(track, rng) for track in truth), truth, hull, shape)


def toss(
    model: ObjectModel, lowest: Callable[[Array], float], rng: np.random.Generator, settings: ShapeTossSettings
) -> tuple[PoseTrack, ...]:
    """Tosses from the air until the object has rested for a while, or to the longest time, without noise.

    Args:
        model: What is tossed.
        lowest: Height of the object's lowest point [m] in a configuration (nq,) whose origin is at z = 0.
        rng: Draws the releases.
        settings: How many, and what engine.
    """
    q0, v0 = np.zeros((settings.tosses, model.nq)), np.zeros((settings.tosses, model.nv))
    for q, v in zip(q0, v0, strict=True):
        quat = rng.normal(size=4)
        q[:2], q[3:7] = rng.uniform(-0.2, 0.2, 2), quat / np.linalg.norm(quat)
        q[7:] = rng.uniform(-np.pi, np.pi, model.n_joints)
        q[2] = HEIGHT - lowest(q)
        v[:2], v[2], v[3:] = rng.uniform(-SPEED, SPEED, 2), rng.uniform(0, 1), SPIN * rng.normal(size=model.nv - 3)
    substeps = round(1 / RATE_HZ / settings.step)
    engine = LcpEngine(substeps=16) if settings.engine == "lcp" else MujocoEngine(substeps=substeps)
    world, dt, n_steps = World(model, gravity=GRAVITY), substeps * settings.step, settings.frames - 1
    run = ENGINES[engine.name].simulate(engine, world, q0, v0, n_steps=n_steps, dt=dt)
    tracks = []
    for i, (q, v) in enumerate(zip(run.q, run.v, strict=True)):
        moving = np.flatnonzero(np.abs(v).max(axis=1) >= STILL)
        end = min(len(q), int(moving[-1]) + 1 + REST_FRAMES)
        tracks.append(PoseTrack(f"{i:03d}", np.arange(end, dtype=float) * dt, np.asarray(q[:end])))
    return tuple(tracks)


def noisy(track: PoseTrack, rng: np.random.Generator) -> PoseTrack:
    """A rigid body's track, of poses (n, 7), with a tracker's noise."""
    q = track.q.copy()
    q[:, :3] += NOISE * rng.normal(size=(len(q), 3))
    q[:, 3:7] = quat_mul(q[:, 3:7], quat_exp(NOISE_RAD * rng.normal(size=(len(q), 3))))
    return PoseTrack(track.name, track.t, q)
