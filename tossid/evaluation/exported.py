"""An exported model beside the one that it was made of: MuJoCo's rollouts against tossid's."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

from tossid.errors import FileError, InputError
from tossid.models.predictor import Predictor
from tossid.objects import ObjectModel, body_poses
from tossid.physics.mujoco_engine import quiet
from tossid.rotations import geodesic_angle

Array = NDArray[np.float64]

STEP = 1e-4
"""MuJoCo's time step [s] in a comparison of free flight."""


@dataclass(frozen=True)
class Apart:
    """Distances (B,) between two rollouts of each start: the largest over frames and bodies of `after` frames.

    position_mm: of the bodies' origins. rotation_deg: of the bodies.
    """

    position_mm: Array
    rotation_deg: Array


def read_export(path: Path) -> mujoco.MjModel:
    """An exported file, as MuJoCo reads it; a URDF's base is given a free joint, as MuJoCo fixes it to the world.

    Raises:
        FileError: MuJoCo cannot read it.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        for root in spec.worldbody.bodies:
            if not list(root.joints):
                root.add_freejoint()
        return spec.compile()
    except ValueError as error:
        raise FileError(path, f"MuJoCo cannot read the export: {error}") from error


def rollouts_apart(
    compiled: mujoco.MjModel,
    predictor: Predictor,
    model: ObjectModel,
    q0: Array,
    v0: Array,
    *,
    frames: int,
    dt: float,
    substeps: int,
) -> Apart:
    """Roll the same starts out in MuJoCo and by the predictor, and compare.

    Args:
        compiled: the export; its time step becomes dt / substeps.
        model: the learned object; its order of q and v is the export's.
        q0: (B, nq). v0: (B, nv).
        frames: after the first. dt: between frames [s].

    Raises:
        InputError: the export has other joints than the object.
    """
    if (compiled.nq, compiled.nv) != (model.nq, model.nv):
        raise InputError(f"the export has {compiled.nq} coordinates, the model {model.nq}")
    compiled.opt.timestep = dt / substeps
    start = np.concatenate([np.zeros((len(q0), 1)), q0, v0], axis=1)
    with quiet():
        states, _ = rollout.rollout(compiled, mujoco.MjData(compiled), start, nstep=frames * substeps)
    theirs = np.asarray(states)[:, substeps - 1 :: substeps, 1 : 1 + model.nq]
    ours = predictor.rollout(q0, v0, n_steps=frames, dt=dt).q[:, 1:]
    (x, a), (y, b) = body_poses(model, ours), body_poses(model, theirs)
    position = np.linalg.norm(x - y, axis=-1).max(axis=(1, 2))
    return Apart(1e3 * position, np.rad2deg(geodesic_angle(a, b).max(axis=(1, 2))))
