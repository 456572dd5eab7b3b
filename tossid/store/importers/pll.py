"""Tosses as dair_pll publishes them (`assets/contactnets_cube`, `assets/contactnets_elbow`)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tossid.errors import FileError, InputError
from tossid.store.importers.checks import check_rate, check_velocities, checked_track, files_of, read_tensor, tracks_of
from tossid.types import PoseTrack


def read_pll(folder: Path, *, n_joints: int, rate_hz: float = 148.0) -> Sequence[PoseTrack]:
    """Read a folder of `N.pt`, each a tensor (n, 13 or 15) in metres and radians.

    Columns: quaternion wxyz (4), position (3), [joint angle], angular velocity
    (3, body), linear velocity (3), [joint rate]. Joint angles that jump by a
    turn are unwrapped: q is continuous.

    Args:
        n_joints: 0 or 1, as the object has.
        rate_hz: frames a second.

    Raises:
        FileError: a file or the folder is not what it should be; names file and row.
    """
    check_rate(rate_hz)
    if n_joints not in (0, 1):
        raise InputError(f"the pll format has no or one joint, the object has {n_joints}")
    folder = Path(folder)

    def read(path: Path) -> PoseTrack:
        rows = read_tensor(path, (13, 15))
        if rows.shape[1] != 13 + 2 * n_joints:
            raise FileError(
                path, f"holds {rows.shape[1]} columns, expected {13 + 2 * n_joints} for an object of {n_joints} joints"
            )
        if not np.isfinite(rows).all():
            row = int(np.argmax(~np.isfinite(rows).all(axis=1)))
            raise FileError(path, "is not finite (NaN or infinity)", row=row)
        quat, p, joints = rows[:, :4], rows[:, 4:7], rows[:, 7 : 7 + n_joints]
        spin, speed, rates = np.split(rows[:, 7 + n_joints :], [3, 6], axis=1)
        q = np.concatenate([p, quat, np.unwrap(joints, axis=0)], axis=1)
        v = np.concatenate([speed, spin, rates], axis=1)
        return checked_track(path, np.arange(len(rows)) / rate_hz, q, v)

    tracks = tracks_of(files_of(folder, ".pt"), read)
    check_velocities(folder, tracks)
    return tracks
