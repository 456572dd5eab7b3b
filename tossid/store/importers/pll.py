"""The format `pll`: tosses as dair_pll publishes them (`assets/contactnets_cube`, `assets/contactnets_elbow`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tossid.errors import FileError, InputError
from tossid.settings.kinds import Positive
from tossid.store.importers.registry import Imported, register_importer

if TYPE_CHECKING:
    from tossid.objects import ObjectModel
    from tossid.types import Array, PoseTrack

COLUMNS = (13, 15)
"""Of an object without and with a joint."""
RATE = 148.0
"""Frames a second of the published recordings [Hz]."""


@dataclass(frozen=True, kw_only=True)
class PllSource:
    """Tosses as published with dair_pll: N.pt files in metres."""

    name: Literal["pll"] = "pll"
    """dair_pll's tensors"""
    path: Path
    """folder of N.pt files"""
    rate_hz: Positive = RATE
    """frames a second"""


def read_pll(folder: Path, *, n_joints: int, rate_hz: float = RATE) -> Sequence[PoseTrack]:
    """The tracks in a folder of `N.pt`, each a tensor (n, 13 or 15) in metres and radians.

    Columns: quaternion wxyz (4), position (3), [joint angle], angular velocity
    (3, body), linear velocity (3), [joint rate]. Joint angles that jump by a
    turn are unwrapped: q is continuous.

    Args:
        folder: Where the files lie.
        n_joints: Joints of the object, 0 or 1.
        rate_hz: Frames a second.

    Returns:
        Tracks with recorded velocities, 2 before 10: linear in the world frame [m/s], angular in the body frame
        [rad/s], joint rates [rad/s].

    Raises:
        FileError: A file or the folder is not what it should be; names file and row.
        InputError: The object has more than one joint, or the rate is not positive.
    """
    import numpy as np

    from tossid.store.recorded_poses.tensors import read_tensor, tensor_tracks

    if n_joints not in (0, 1):
        raise InputError(f"the pll format has no or one joint, the object has {n_joints}")

    def read(path: Path) -> tuple[Array, Array]:
        rows = read_tensor(path, COLUMNS)
        if rows.shape[1] != 13 + 2 * n_joints:
            raise FileError(
                path, f"holds {rows.shape[1]} columns, expected {13 + 2 * n_joints} for an object of {n_joints} joints"
            )
        quat, p, joints = rows[:, :4], rows[:, 4:7], rows[:, 7 : 7 + n_joints]
        spin, speed, rates = np.split(rows[:, 7 + n_joints :], [3, 6], axis=1)
        q = np.concatenate([p, quat, np.unwrap(joints, axis=0)], axis=1)
        return q, np.concatenate([speed, spin, rates], axis=1)

    return tensor_tracks(folder, read, rate_hz=rate_hz)


def _import(source: PllSource, model: ObjectModel) -> Imported:
    tracks = read_pll(source.path, n_joints=model.n_joints, rate_hz=source.rate_hz)
    return Imported(tracks, source.rate_hz)


def _recognizes(path: Path) -> bool:
    from tossid.store.recorded_poses.tensors import has_columns

    return has_columns(path, COLUMNS)


register_importer(PllSource, _import, recognizes=_recognizes, default_object="elbow")
