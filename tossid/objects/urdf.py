"""Objects written as URDF, whose contact geometry is one mesh file a body."""

from __future__ import annotations

import re
from xml.etree import ElementTree as xml

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from tossid.errors import ObjectError, brief
from tossid.objects.model import JointType, ObjectModel
from tossid.rotations import quat_to_matrix

Array = NDArray[np.float64]


def to_urdf(model: ObjectModel, *, meshes: str) -> tuple[str, dict[str, str]]:
    """The object as URDF text, and its meshes' files.

    Joints become `continuous` and `prismatic` (without limits, which some readers ask for); their damping and friction
    go along. What the format has no word for stays behind: friction and softness of contact, gravity, joints'
    stiffness and armature.

    Args:
        model: The object.
        meshes: Beginning of the mesh files' names; they lie beside the URDF.

    Returns:
        text, and for each mesh file's name its content (Wavefront OBJ, metres).

    Raises:
        ObjectError: a body's corners span no volume, or its name can be no part of a file's.
    """
    robot = xml.Element("robot", name=model.name)
    compiler = xml.SubElement(robot, "mujoco")
    xml.SubElement(compiler, "compiler", fusestatic="false", strippath="false", balanceinertia="false")
    files: dict[str, str] = {}
    for b, name in enumerate(model.body_names):
        link = xml.SubElement(robot, "link", name=name)
        inertial = xml.SubElement(link, "inertial")
        xml.SubElement(inertial, "origin", xyz=_text(_from_link(model, b, model.com[b])), rpy="0 0 0")
        xml.SubElement(inertial, "mass", value=repr(float(model.mass[b])))
        I = model.inertia[b]
        places = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
        xml.SubElement(inertial, "inertia", {key: repr(float(I[at])) for key, at in places.items()})
        if (model.corner_body == b).any():
            own = model.hull_points(b)
            if not re.fullmatch(r"[\w .+-]+", name) or name.startswith("."):
                raise ObjectError(
                    f"body {brief(name)} cannot be a part of a mesh file's name; expected letters and digits"
                )
            file = f"{meshes}_{name}.obj"
            files[file] = _mesh(_from_link(model, b, own), name)
            for kind in ("visual", "collision"):
                geometry = xml.SubElement(xml.SubElement(link, kind), "geometry")
                xml.SubElement(geometry, "mesh", filename=file)
    for b in range(1, model.n_bodies):
        kind = "continuous" if model.joint_type[b] == JointType.HINGE else "prismatic"
        joint = xml.SubElement(robot, "joint", name=f"joint_{b}", type=kind)
        up = int(model.parent[b])
        # a URDF link's frame is its joint's: it lies in the joint's anchor
        anchor = model.body_pos[b] + quat_to_matrix(model.body_quat[b]) @ model.joint_pos[b]
        roll_pitch_yaw = _rpy(quat_to_matrix(model.body_quat[b]))
        xml.SubElement(joint, "origin", xyz=_text(_from_link(model, up, anchor)), rpy=_text(roll_pitch_yaw))
        xml.SubElement(joint, "parent", link=model.body_names[up])
        xml.SubElement(joint, "child", link=model.body_names[b])
        xml.SubElement(joint, "axis", xyz=_text(model.joint_axis[b]))
        damping, friction = (repr(float(part[b])) for part in (model.joints.damping, model.joints.friction))
        xml.SubElement(joint, "dynamics", damping=damping, friction=friction)
    xml.indent(robot)
    return xml.tostring(robot, encoding="unicode", xml_declaration=True) + "\n", files


def _from_link(model: ObjectModel, body: int, points: Array) -> Array:
    """Points of a body's frame (*b, 3) in its URDF link's, whose origin is the joint's anchor."""
    return points - model.joint_pos[body] if body else points


def _mesh(corners: Array, name: str) -> str:
    """The corners' convex hull, faces outward."""
    try:
        hull = ConvexHull(corners)
    except Exception as error:
        raise ObjectError(f"the corners of '{name}' span no volume") from error
    middle, lines = corners.mean(axis=0), [f"o {name}"]
    lines += [f"v {_text(corner)}" for corner in corners]
    for face in hull.simplices:
        a, b, c = corners[face]
        i, j, k = face + 1
        # Qhull gives faces in no order of turning
        outward = np.dot(np.cross(b - a, c - a), a - middle) > 0
        lines.append(f"f {i} {j} {k}" if outward else f"f {i} {k} {j}")
    return "\n".join(lines) + "\n"


def _rpy(R: Array) -> Array:
    """Roll, pitch, yaw [rad] with R = R_z(yaw) R_y(pitch) R_x(roll)."""
    pitch = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    if np.hypot(R[0, 0], R[1, 0]) < 1e-9:  # looks straight up or down: yaw is free
        return np.array([np.arctan2(-R[1, 2], R[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])])


def _text(values: Array) -> str:
    return " ".join(repr(float(x)) for x in values)
