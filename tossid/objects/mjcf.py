"""Objects from MJCF or URDF, through MuJoCo's parser, and back to MJCF."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypedDict

import mujoco
import numpy as np
from numpy.typing import NDArray

from tossid.errors import FileError, ObjectError
from tossid.objects.files.friction import friction_of
from tossid.objects.files.model_file import first_line, read_model_file
from tossid.objects.files.outline import hull_vertices, outline
from tossid.objects.geoms import add_geoms
from tossid.objects.model import GRAVITY, JointLaw, JointType, ObjectModel, Tag
from tossid.objects.roundness import RIM, Roundness, ball, disc, ellipsoid, joined, points
from tossid.rotations import quat_to_matrix

Array = NDArray[np.float64]

_JOINTS = {mujoco.mjtJoint.mjJNT_HINGE: JointType.HINGE, mujoco.mjtJoint.mjJNT_SLIDE: JointType.SLIDE}


class Stated(TypedDict, total=False):
    """What an object's file cannot say.

    Attributes:
        name: The object's name; the model's own by default.
        friction: Coulomb's coefficient of object and ground; what the file states by default, else a guess of 0.18.
        restitution: Newton's coefficient, 0 by default.
        compliance: How far a corner sinks for each newton on it [m/N], 0 by default.
        relaxation: Damping over stiffness of a corner [s], 0 by default.
        cohesion: Friction of a loaded corner beyond `friction` times its load [N], 0 by default.
        width: The length that relative position errors refer to [m]; the longest edge of the base by default.
        tags: AprilTags on the bodies, or the path of a file that lists them in TagSLAM's form (`load_object` only).
    """

    name: str | None
    friction: float | None
    restitution: float
    compliance: float
    relaxation: float
    cohesion: float
    width: float | None
    tags: Sequence[Tag] | str | Path | None


def object_from_file(path: Path, *, friction: float | None = None) -> ObjectModel:
    """The object of an MJCF or URDF file, without what the file cannot say.

    Of a body with mesh files, the corners are those of the convex hull of all its geoms (`outline`), because nothing
    else can touch the ground; its text (`ObjectModel.mjcf`) holds these, because a dataset carries no mesh files.

    Args:
        path: The file. A base without a joint gets a free joint.
        friction: Coulomb's coefficient of object and ground; None: as the file states it, else a guess, of which is
            logged.

    Raises:
        FileError: The file is missing, asks for too much, MuJoCo cannot parse it, or it states several frictions.
        ObjectError: It is no tree of one free base with hinges and slides.
    """
    file = read_model_file(path)
    _free_base(file.spec)
    m = file.compiled()
    try:
        found = friction_of(m, file.texts, friction, file=path.name)
        if file.has_mesh_files:
            text = to_mjcf(_outlined(_from_model(m, "", name=file.spec.modelname, friction=found.value)), ground=False)
        else:
            text = file.spec.to_xml()
    except ObjectError as error:
        raise FileError(path, str(error)) from error
    except UnicodeDecodeError as error:
        raise FileError(path, "holds letters that are not UTF-8, its own or an included file's") from error
    # arrays and text must agree to the last digit: read back what will be kept
    model = object_from_mjcf(text, friction=found.value)
    found.say()
    return model


def object_from_mjcf(text: str, **stated: Any) -> ObjectModel:
    """The object of MJCF text, as a dataset carries it.

    Args:
        text: MJCF that names no other files.
        **stated: What the text cannot say, see `Stated`; `tags` as a sequence.

    Raises:
        ObjectError: MuJoCo cannot parse the text, it is no tree of one free base with hinges and slides, or it states
            several frictions and none is given.
    """
    doing = "parse"
    try:
        spec = mujoco.MjSpec.from_string(text)
        _free_base(spec)
        doing = "compile"
        m = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise ObjectError(f"MuJoCo cannot {doing} the object's MJCF: {first_line(error)}") from error
    stated["name"] = stated.get("name") or spec.modelname
    if stated.get("friction") is not None:
        return _from_model(m, text, **stated)
    found = friction_of(m, [text], None, file=f"the MJCF of '{stated['name']}'")
    model = _from_model(m, text, **{**stated, "friction": found.value})
    found.say()
    return model


def _from_model(
    m: mujoco.MjModel, text: str, *, width: float | None = None, tags: Sequence[Tag] = (), **stated: Any
) -> ObjectModel:
    """The object of a compiled model; `stated` holds its name and friction at least, see `Stated`."""
    kinds, pos, axes = _joints(m)
    if m.neq:
        raise ObjectError(f"the object has {m.neq} equality constraints (loops, locks), which are not supported")
    R = quat_to_matrix(m.body_iquat[1:])
    corner_body, corner_pos, roundness = _corners(m)
    if not len(corner_body):
        raise ObjectError("the object has no box, mesh or round geom that could touch the ground")
    model = ObjectModel(
        body_names=tuple(m.body(b).name or f"body_{b - 1}" for b in range(1, m.nbody)),
        parent=np.asarray(m.body_parentid[1:], dtype=np.int64) - 1,
        joint_type=kinds,
        joint_pos=pos,
        joint_axis=axes,
        body_pos=np.array(m.body_pos[1:]),
        body_quat=np.array(m.body_quat[1:]),
        mass=np.array(m.body_mass[1:]),
        com=np.array(m.body_ipos[1:]),
        inertia=R @ (m.body_inertia[1:, :, None] * np.swapaxes(R, -1, -2)),
        corner_body=corner_body,
        corner_pos=corner_pos,
        width=1.0 if width is None else float(width),
        tags=tuple(tags),
        mjcf=text,
        joint_law=_joint_law(m),
        roundness=roundness,
        **{"restitution": 0.0, **stated},
    )
    if width is not None:
        return model
    low, high = model.extent(int(corner_body[0]))
    return model.with_changes(width=float((high - low).max()))


def _joints(m: mujoco.MjModel) -> tuple[NDArray[np.int64], Array, Array]:
    """Kind, anchor [m] and axis of each body's joint, in the body's frame: a free base, then hinges and slides."""
    n = m.nbody - 1
    kinds, pos, axes = np.zeros(n, dtype=np.int64), np.zeros((n, 3)), np.tile([0.0, 0.0, 1.0], (n, 1))
    for body in range(n):
        name, count = m.body(body + 1).name, int(m.body_jntnum[body + 1])
        first = int(m.body_jntadr[body + 1])
        kind = mujoco.mjtJoint(m.jnt_type[first]) if count == 1 else None
        if body == 0:
            if kind != mujoco.mjtJoint.mjJNT_FREE:
                raise ObjectError(f"the base '{name}' needs one free joint")
            continue
        if kind not in _JOINTS:
            raise ObjectError(f"body '{name}' needs exactly one hinge or slide joint to its parent")
        _refuse_joint(m, first)
        kinds[body], pos[body], axes[body] = _JOINTS[kind], m.jnt_pos[first], m.jnt_axis[first]
    return kinds, pos, axes


def _joint_law(m: mujoco.MjModel) -> JointLaw:
    """What the file says of the joints: every body but the base has one, in the order of bodies."""

    def by_body(values: Array) -> Array:
        return np.concatenate([[0.0], np.asarray(values, dtype=float)])

    return JointLaw(
        damping=by_body(m.dof_damping[6:]),
        friction=by_body(m.dof_frictionloss[6:]),
        stiffness=by_body(m.jnt_stiffness[1:]),
        rest=by_body(m.qpos_spring[7:]),
        armature=by_body(m.dof_armature[6:]),
    )


def _refuse_joint(m: mujoco.MjModel, joint: int) -> None:
    """Say what of a hinge or slide tossid's equations do not have."""
    dof, named = int(m.jnt_dofadr[joint]), f"joint '{m.joint(joint).name or joint}'"
    if m.jnt_limited[joint]:
        low, high = m.jnt_range[joint]
        raise ObjectError(f"{named} has limits ({low:g} to {high:g}); joints without limits are supported")
    if m.qpos0[m.jnt_qposadr[joint]] != 0:
        raise ObjectError(f"{named} has a reference position ('ref'), which is not supported")
    if m.dof_dampingpoly[dof].any() or m.jnt_stiffnesspoly[joint].any():
        raise ObjectError(f"{named} has damping or stiffness that is not linear, which is not supported")


def _free_base(spec: mujoco.MjSpec) -> None:
    """Give the one root body a free joint, unless it has a joint: a jointless root would be part of the world."""
    roots = list(spec.worldbody.bodies)
    if len(roots) != 1:
        raise ObjectError(f"the object has {len(roots)} root bodies, expected exactly one free base")
    if not list(roots[0].joints):
        roots[0].add_freejoint()


def _outlined(model: ObjectModel) -> ObjectModel:
    """The object whose corners are the outline of each body; as it is where it has round parts."""
    if model.roundness is not None:
        return model
    of = [outline(model.corner_pos[model.corner_body == b]) for b in sorted(set(model.corner_body.tolist()))]
    bodies = np.repeat(np.unique(model.corner_body), [len(points) for points in of])
    return model.with_changes(corner_body=bodies, corner_pos=np.concatenate(of))


def _hull(m: mujoco.MjModel, mesh: int) -> Array:
    """Vertices (n, 3) of a mesh's convex hull, as MuJoCo holds them.

    Raises:
        ObjectError: the mesh spans no volume.
    """
    first, count = int(m.mesh_vertadr[mesh]), int(m.mesh_vertnum[mesh])
    vertices = np.asarray(m.mesh_vert[first : first + count], dtype=float)
    try:
        return hull_vertices(vertices)
    except ObjectError as error:
        raise ObjectError(f"mesh '{m.mesh(mesh).name}' has no convex hull: {error}") from error


def _corners(m: mujoco.MjModel) -> tuple[NDArray[np.int64], Array, Roundness | None]:
    """Corners of boxes, hull vertices of meshes and round parts, in their bodies' frames."""
    bodies: list[int] = []
    corners, rounds = [np.zeros((0, 3))], [points(0)]
    for geom in range(m.ngeom):
        if m.geom_bodyid[geom] == 0 or (m.geom_contype[geom] == 0 and m.geom_conaffinity[geom] == 0):
            continue
        local, roundness = _of_geom(m, geom)
        corners.append(local @ quat_to_matrix(m.geom_quat[geom]).T + m.geom_pos[geom])
        rounds.append(roundness)
        bodies += [int(m.geom_bodyid[geom]) - 1] * len(local)
    found = joined(rounds)
    is_round = bool(found.radius.any() or found.root.any())
    return np.asarray(bodies, dtype=np.int64), np.concatenate(corners), found if is_round else None


_SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)


def _of_geom(m: mujoco.MjModel, geom: int) -> tuple[Array, Roundness]:
    """Corners (n, 3) in the geom's frame [m], and what stands there, in the axes of its body."""
    kind, size = mujoco.mjtGeom(m.geom_type[geom]), np.array(m.geom_size[geom])
    R = quat_to_matrix(m.geom_quat[geom])
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return _SIGNS * size, points(8)
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        hull = _hull(m, int(m.geom_dataid[geom]))
        return hull, points(len(hull))
    ends = np.array([[0, 0, -size[1]], [0, 0, size[1]]])
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.zeros((1, 3)), ball(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return ends, joined([ball(size[0])] * 2)
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return np.zeros((1, 3)), ellipsoid(size, R)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return np.repeat(ends, RIM, axis=0), joined([disc(size[0], R[:, 2])] * 2)
    raise ObjectError(
        f"a geom of type {kind.name} has no convex hull; use boxes, spheres, ellipsoids, capsules, cylinders or meshes"
    )


def to_mjcf(
    model: ObjectModel,
    *,
    gravity: float = GRAVITY,
    timestep: float = 0.001,
    ground: bool = True,
    solref: tuple[float, float] = (0.002, 1.0),
    solimp: tuple[float, ...] = (0.98, 0.9999, 0.0001, 0.5, 2.0),
) -> str:
    """A MuJoCo scene of the object over the ground plane z = 0, which runs as it is.

    The corners become one convex mesh a body, so that learned geometry, which is no box any more, survives. Round parts
    become spheres, ellipsoids and thin cylinders, whose hull is the body's; where round edges leave none of these, a
    mesh of many points. Contact between the object's own bodies is off.

    Args:
        model: The object.
        gravity: Downward acceleration [m/s²].
        timestep: MuJoCo's time step [s].
        ground: Add the ground plane.
        solref: MuJoCo's reference of contact: time constant [s] and damping ratio; near rigid by default.
        solimp: MuJoCo's impedance of contact; near rigid by default.

    Returns:
        MJCF text.
    """
    spec = mujoco.MjSpec()
    spec.modelname = model.name
    spec.compiler.degree = False
    spec.option.gravity = [0.0, 0.0, -gravity]
    spec.option.timestep = timestep
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    contact = {"solref": list(solref), "solimp": list(solimp), "friction": [model.friction, 0.0, 0.0], "condim": 3}
    if ground:
        spec.worldbody.add_geom(
            name="ground", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], contype=1, conaffinity=2, **contact
        )
    bodies: list[mujoco.MjsBody] = []
    for b in range(model.n_bodies):
        up = spec.worldbody if model.parent[b] < 0 else bodies[model.parent[b]]
        body = up.add_body(
            name=model.body_names[b],
            pos=model.body_pos[b] if b else [0, 0, 0],
            quat=model.body_quat[b] if b else [1, 0, 0, 0],
        )
        I = _rounds(model.inertia[b])
        body.explicitinertial = True
        body.mass, body.ipos = float(model.mass[b]), model.com[b]
        body.fullinertia = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]
        if b == 0:
            body.add_freejoint()
        else:
            kind = (
                mujoco.mjtJoint.mjJNT_HINGE if model.joint_type[b] == JointType.HINGE else mujoco.mjtJoint.mjJNT_SLIDE
            )
            body.add_joint(
                name=f"joint_{b}",
                type=kind,
                pos=model.joint_pos[b],
                axis=model.joint_axis[b],
                limited=False,
                damping=[model.joints.damping[b], 0, 0],
                stiffness=[model.joints.stiffness[b], 0, 0],
                frictionloss=model.joints.friction[b],
                springref=model.joints.rest[b],
                armature=model.joints.armature[b],
            )
        add_geoms(spec, body, model, b, contact)
        bodies.append(body)
    spec.compile()
    return spec.to_xml()


def _rounds(inertia: Array) -> Array:
    """Inertia (3, 3) that stays possible in the six digits that MuJoCo writes: that of a sheet is at the limit."""
    values, axes = np.linalg.eigh(inertia)
    lack = max(0.0, (1 + 2e-5) * values[2] - values[0] - values[1])
    values[:2] += lack / 2
    out: Array = inertia if lack == 0.0 else (axes * values) @ axes.T
    return out
