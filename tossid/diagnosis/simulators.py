"""The simulators that can be diagnosed, as worlds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from tossid.diagnosis.engines import Engine
from tossid.diagnosis.patch import read_spec
from tossid.diagnosis.windows import steps_of
from tossid.errors import InputError
from tossid.objects import ObjectModel, load_object
from tossid.physics.effects import Recording, World
from tossid.physics.forces import Forces
from tossid.rotations import geodesic_angle, quat_rotate
from tossid.types import Toss

if TYPE_CHECKING:
    from tossid.models.protocol import DynamicsModel

ANOTHER = 1.6
"""Ratio of the edges of two objects beyond which one is not a wrong statement of the other."""
STILL = 10.0
"""Standard deviations of poses within which nothing moves."""


def world_of_model(model: DynamicsModel) -> World:
    """The world of a trained model: what it has learned, and the rest as given.

    Raises:
        InputError: the model is no simulator with an object (e2e).
    """
    # takes seconds to load, and is needed for trained models alone
    from tossid.models.contactnets import ContactNets

    if not isinstance(model, ContactNets):
        raise InputError("a network (e2e) has no object and no contact that could be diagnosed; name another run")
    residual = None if model.residual is None else model.residual.arrays()
    return World(
        model.learned_object(),
        gravity=model.settings.gravity,
        recording=Recording(length_scale=model.measurement.length_scale),
        residual=residual,
    )


def world_of_mjcf(path: Path, *, width: float) -> tuple[World, Engine]:
    """The world of a user's MuJoCo model, with contact as if it were rigid, and what MuJoCo makes of the model itself.

    Args:
        width: of the dataset's object [m], which errors refer to.

    Raises:
        FileError, ObjectError: the file cannot be read, or is no single free body.
        InputError: it has no ground that is a plane.
    """
    given = load_object(path, width=width)
    m = read_spec(path).compile()
    grounds = [g for g in range(m.ngeom) if m.geom_bodyid[g] == 0 and (m.geom_contype[g] or m.geom_conaffinity[g])]
    own = [g for g in range(m.ngeom) if m.geom_bodyid[g] != 0 and (m.geom_contype[g] or m.geom_conaffinity[g])]
    if len(grounds) != 1 or m.geom_type[grounds[0]] != mujoco.mjtGeom.mjGEOM_PLANE:
        raise InputError(f"{path}: has {len(grounds)} geoms to land on, expected one: the ground, a plane")
    ground = grounds[0]
    normal = quat_rotate(m.geom_quat[ground], np.array([0.0, 0.0, 1.0]))
    tilt = _tilt_of(normal)
    g, mass = m.opt.gravity, float(given.mass.sum())
    world = World(
        given.with_changes(friction=_friction(m, ground, own[0])),
        gravity=float(-g[2]),
        forces=Forces(x=float(mass * g[0]), y=float(mass * g[1])),
        ground_height=float(m.geom_pos[ground] @ normal),
        ground_tilt=tilt,
    )
    return world, Engine(m, world)


def _tilt_of(normal: np.ndarray) -> tuple[float, float]:
    """Rotation vector (about x, y) that takes the vertical to a plane's normal."""
    axis = np.array([-normal[1], normal[0]])
    size = float(np.linalg.norm(axis))
    if size < 1e-12:
        return 0.0, 0.0
    angle = float(np.arctan2(size, normal[2]))
    return float(axis[0] / size * angle), float(axis[1] / size * angle)


def _friction(m: mujoco.MjModel, ground: int, own: int) -> float:
    """Sliding friction of two geoms as MuJoCo combines it: of their pair, of the one with priority, or the larger."""
    for pair in range(m.npair):
        if {int(m.pair_geom1[pair]), int(m.pair_geom2[pair])} == {ground, own}:
            return float(m.pair_friction[pair, 0])
    order = int(m.geom_priority[own]) - int(m.geom_priority[ground])
    one, other = float(m.geom_friction[own, 0]), float(m.geom_friction[ground, 0])
    return one if order > 0 else other if order < 0 else max(one, other)


def check_same_object(world: World, recorded: ObjectModel, *, where: str) -> None:
    """Refuse a simulator of another object than the one that was tossed.

    Raises:
        InputError: it has other joints, or another size.
    """
    given = world.object
    if given.n_joints != recorded.n_joints:
        raise InputError(
            f"{where}: tosses of '{recorded.name}' with {recorded.n_joints} joints, the simulator's '{given.name}' "
            f"has {given.n_joints}; both must be of the same object"
        )
    ratio = np.ptp(given.corner_pos, axis=0) / np.ptp(recorded.corner_pos, axis=0)
    if (np.maximum(ratio, 1 / ratio) > ANOTHER).any():
        sizes = [" x ".join(f"{1e3 * x:.0f}" for x in np.ptp(o.corner_pos, axis=0)) for o in (given, recorded)]
        raise InputError(
            f"{where}: tosses of '{recorded.name}' ({sizes[1]} mm), the simulator's '{given.name}' measures "
            f"{sizes[0]} mm; both must be of the same object"
        )


def check_runs(world: World, tosses: tuple[Toss, ...], *, where: str, n_threads: int) -> list[str]:
    """Names of the tosses that the simulator does not survive, where they are few.

    Raises:
        InputError: they are many: more than a tenth.
    """
    q, v = np.stack([toss.q[0] for toss in tosses]), np.stack([toss.v[0] for toss in tosses])
    steps = np.array([len(toss) - 1 for toss in tosses])
    dt = float(np.median(np.concatenate([np.diff(toss.t) for toss in tosses])))
    run = world.roll_out(q, v, n_steps=steps, dt=dt, **steps_of(world), n_threads=n_threads)
    far = np.nanmax(np.abs(np.where(np.isfinite(run[..., :3]), run[..., :3], np.inf)), axis=(1, 2))
    lost = [toss.name for toss, size in zip(tosses, far, strict=True) if not size < 1e3]
    if len(lost) > 0.1 * len(tosses):
        raise InputError(
            f"{where}: the simulator diverges (NaN, or farther than 1 km) on {len(lost)} of {len(tosses)} tosses, "
            f"the first of them '{lost[0]}'"
        )
    return lost


def moves(toss: Toss) -> bool:
    """Whether anything moves in a toss: farther than `STILL` times the noise of its poses, from its first frame."""
    std = np.sqrt(np.median(np.einsum("nii->ni", toss.measured[1]), axis=0))
    far = np.linalg.norm(toss.q[:, :3] - toss.q[0, :3], axis=1).max()
    turned = geodesic_angle(toss.q[:, 3:7], toss.q[0, 3:7]).max()
    return bool(far > STILL * max(std[:3].max(), 1e-4) or turned > STILL * max(std[3:6].max(), 1e-3))
