"""Geoms of MJCF for the corners of an object's bodies."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from tossid.objects.model import ObjectModel
from tossid.rotations import matrix_to_quat

Array = NDArray[np.float64]

THIN = 1e-5
"""Half height of a cylinder that stands for a disc [m]."""
POINT = 1e-6
"""Radius of a sphere that stands for a lone corner beside round parts [m]."""


def add_geoms(spec: mujoco.MjSpec, to: mujoco.MjsBody, model: ObjectModel, body: int, contact: dict[str, Any]) -> None:
    """Add the geoms of one body, which collide with the ground alone; their names begin with hull_BODY.

    Args:
        spec: The scene.
        to: Its body.
        model: The object.
        body: Number of the body.
        contact: MuJoCo's contact parameters of a geom.
    """
    own = model.corner_body == body
    if not own.any():
        return
    common = {"contype": 2, "conaffinity": 0, **contact}
    if model.roundness is None:
        _mesh(spec, to, model.corner_pos[own], f"hull_{body}", common)
        return
    at, roundness = model.corner_pos[own], model.roundness.of(own)
    sharp, geoms, seen = [], list[dict[str, Any]](), set[tuple[float, ...]]()
    for place, radius, root in zip(at, roundness.radius, roundness.root, strict=True):
        key = (*place, radius, *root.ravel())
        if key in seen:  # another point of the same rim
            continue
        seen.add(key)
        sizes, axes = np.linalg.eigh(root)
        axes = axes * np.sign(np.linalg.det(axes))
        largest = sizes[-1]
        if largest == 0.0 and radius == 0.0:
            sharp.append(place)
        elif largest == 0.0:
            geoms.append({"type": mujoco.mjtGeom.mjGEOM_SPHERE, "size": [radius, 0, 0], "pos": place})
        elif radius == 0.0 and sizes[0] > 1e-6 * largest:
            quat = matrix_to_quat(axes)
            geoms.append({"type": mujoco.mjtGeom.mjGEOM_ELLIPSOID, "size": sizes, "pos": place, "quat": quat})
        elif radius == 0.0 and sizes[1] > (1 - 1e-6) * largest:
            quat = matrix_to_quat(axes[:, [1, 2, 0]])  # the axis of a cylinder is its z
            geoms.append(
                {"type": mujoco.mjtGeom.mjGEOM_CYLINDER, "size": [largest, THIN, 0], "pos": place, "quat": quat}
            )
        else:  # round edges, or another shape that MuJoCo has no geom for
            _mesh(spec, to, model.hull_points(body), f"hull_{body}", common)
            return
    if len(sharp) < 4:  # spans no volume by itself
        geoms += [{"type": mujoco.mjtGeom.mjGEOM_SPHERE, "size": [POINT, 0, 0], "pos": place} for place in sharp]
        sharp = []
    if sharp:
        _mesh(spec, to, np.array(sharp), f"hull_{body}", common)
    for number, geom in enumerate(geoms, start=int(bool(sharp))):
        to.add_geom(name=f"hull_{body}_{number}" if number else f"hull_{body}", **geom, **common)


def _mesh(spec: mujoco.MjSpec, to: mujoco.MjsBody, points: Array, name: str, common: dict[str, Any]) -> None:
    spec.add_mesh(name=name, uservert=points.ravel(), inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX)
    to.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, **common)
