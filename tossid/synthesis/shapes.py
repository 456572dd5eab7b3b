"""Convex objects of several kinds, tossed by an engine, as tracked poses: data for learning objects from nothing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from tossid.objects import ObjectModel, object_from_mjcf
from tossid.objects.roundness import Roundness, directions, disc
from tossid.physics import make_system, simulate
from tossid.physics.mujoco_engine import RIGID_DAMPING, RIGID_SOLIMP, quiet
from tossid.rotations import quat_exp, quat_mul, quat_to_matrix
from tossid.settings.synthesis import ShapeTossSettings
from tossid.types import PoseTrack

Array = NDArray[np.float64]


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


def _polytope(points: Array) -> str:
    return f'<mesh name="m" vertex="{_row(points.ravel())}"/>'


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
STILL = 0.02
"""Largest velocity of a body at rest [m/s, rad/s]."""
LCP_SUBSTEPS, LCP_PARTS = 16, 8
"""Steps of tossid's own engine a frame, and parts of a step with an impact: four times those of a learned model."""


def toss_shape(name: str, settings: ShapeTossSettings | None = None) -> TossedShape:
    """Tosses of a shape.

    The body's frame lies off the shape's middle and off its centre of mass, as a tracker's does.

    Args:
        name: Of `SHAPES`.
        settings: How many, how noisy.
    """
    settings = settings or ShapeTossSettings()
    points, geom = _shapes()[name]
    off = np.array(settings.frame_offset)
    mesh = "" if geom is not None else _polytope(points)
    geom = geom or 'type="mesh" mesh="m"'
    body = f"""<mujoco model="{name}">
  <asset>{mesh}</asset>
  <worldbody>
    <body name="{name}">
      <freejoint/>
      <geom name="hull" {geom} pos="{_row(off)}" mass="{settings.mass}"/>
    </body>
  </worldbody>
</mujoco>"""
    spec = mujoco.MjSpec.from_string(body)
    for each in spec.meshes:
        each.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_EXACT
    spec.option.timestep = settings.step
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10
    law = contact_law(settings)
    for key, value in law.items():
        setattr(spec.geoms[0], key, value)
    spec.worldbody.add_geom(name="ground", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], **law)
    model = spec.compile()
    if mesh:  # MuJoCo turns a mesh into its principal axes: undo it for the truth
        R, at = (
            quat_to_matrix(model.geom_quat[0 if model.geom_bodyid[0] else 1]),
            model.geom_pos[0 if model.geom_bodyid[0] else 1],
        )
        first, count = model.mesh_vertadr[0], model.mesh_vertnum[0]
        hull = np.asarray(model.mesh_vert[first : first + count], dtype=float) @ R.T + at
        hull = hull[ConvexHull(hull).vertices]
    else:
        hull = points + off
    R = quat_to_matrix(model.body_iquat[1])
    inertia = R @ np.diag(model.body_inertia[1]) @ R.T
    rng = np.random.default_rng([settings.seed, SHAPES.index(name)])
    object_ = _object(name, body, model, inertia, settings)
    releases = [_release(hull, rng, settings) for _ in range(settings.tosses)]
    if settings.engine == "lcp":
        truth = by_lcp(object_, releases, settings)
    else:
        truth = tuple(toss_from(model, q, v, f"{i:03d}", settings) for i, (q, v) in enumerate(releases))
    tracks = tuple(noisy(track, rng, settings) for track in truth)
    return TossedShape(name, tracks, truth, hull, object_)


def contact_law(settings: ShapeTossSettings) -> dict[str, Any]:
    """Attributes of MuJoCo's geoms with which contact is near rigid."""
    return {
        "friction": [settings.friction, 0, 0],
        "condim": 3,
        "solref": [2 * settings.step, RIGID_DAMPING],
        "solimp": list(RIGID_SOLIMP),
    }


def _object(name: str, mjcf: str, model: mujoco.MjModel, inertia: Array, settings: ShapeTossSettings) -> ObjectModel:
    """The object of a shape."""
    found = object_from_mjcf(mjcf, friction=settings.friction)
    found = found.with_changes(com=np.array(model.body_ipos[1])[None], inertia=inertia[None])
    if name not in ROUND:
        return found
    count = len(ROUND[name].radius)
    return found.with_changes(
        corner_body=np.zeros(count, dtype=np.int64),
        corner_pos=np.tile(settings.frame_offset, (count, 1)),
        roundness=ROUND[name],
    )


def _release(hull: Array, rng: np.random.Generator, settings: ShapeTossSettings) -> tuple[Array, Array]:
    """A first pose (7,) and velocity (6,)."""
    quat = rng.normal(size=4)
    quat /= np.linalg.norm(quat)
    lowest = float((quat_to_matrix(quat)[2] @ hull.T).min())
    q = np.array([*rng.uniform(-0.2, 0.2, 2), settings.height - lowest, *quat])
    v = np.array([*rng.uniform(-settings.speed, settings.speed, 2), rng.uniform(0, 1), *rng.normal(size=3)])
    v[3:] *= settings.spin
    return q, v


def toss_from(model: mujoco.MjModel, q0: Array, v0: Array, name: str, settings: ShapeTossSettings) -> PoseTrack:
    """A toss from the air to rest, or to the longest time.

    Args:
        model: MuJoCo's.
        q0: First configuration, (nq,).
        v0: First velocity, (nv,).
        name: Of the toss.
        settings: Its rate and length.
    """
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = q0, v0
    per_frame, q, still = 1 / settings.rate_hz, [data.qpos.copy()], 0
    steps = round(per_frame / model.opt.timestep)
    with quiet():
        while len(q) < settings.frames and still < settings.rest_frames:
            mujoco.mj_step(model, data, steps)
            q.append(data.qpos.copy())
            still = still + 1 if np.abs(data.qvel).max() < STILL else 0
    return PoseTrack(name, np.arange(len(q)) * steps * model.opt.timestep, np.array(q))


def by_lcp(
    model: ObjectModel, releases: list[tuple[Array, Array]], settings: ShapeTossSettings
) -> tuple[PoseTrack, ...]:
    """The same tosses by tossid's own time stepping, whose contact is rigid and whose friction is Coulomb's.

    Args:
        model: The object.
        releases: First configuration (nq,) and velocity (nv,) of each.
        settings: Their rate and length.
    """
    q0, v0 = (np.array(part) for part in zip(*releases, strict=True))
    system = make_system(model)
    dt, n = round(1 / settings.rate_hz / settings.step) * settings.step, settings.frames - 1  # as of MuJoCo's frames
    run = simulate(system, q0, v0, n_steps=n, dt=dt, substeps=LCP_SUBSTEPS, impact_parts=LCP_PARTS)
    tracks = []
    for i, (q, v) in enumerate(zip(run.q, run.v, strict=True)):
        moving = np.flatnonzero(np.abs(v).max(axis=1) >= STILL)
        end = min(len(q), int(moving[-1]) + 1 + settings.rest_frames)
        tracks.append(PoseTrack(f"{i:03d}", np.arange(end, dtype=float) * dt, np.asarray(q[:end])))
    return tuple(tracks)


def noisy(track: PoseTrack, rng: np.random.Generator, settings: ShapeTossSettings) -> PoseTrack:
    """A rigid body's track with a tracker's noise.

    Args:
        track: (n, 7).
        rng: Draws the noise.
        settings: Its size.
    """
    q = track.q.copy()
    q[:, :3] += settings.noise * rng.normal(size=(len(q), 3))
    q[:, 3:7] = quat_mul(q[:, 3:7], quat_exp(settings.noise_rad * rng.normal(size=(len(q), 3))))
    return PoseTrack(track.name, track.t, q)
