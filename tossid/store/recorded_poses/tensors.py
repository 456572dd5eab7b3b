"""Published tosses as tensors, one `.pt` file a toss, with recorded velocities: what such formats share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tossid import budget
from tossid.errors import FileError, InputError
from tossid.rotations import quat_boxminus, xyzw_to_wxyz
from tossid.store.importers.registry import holds
from tossid.store.recorded_poses.checks import checked_track, files_of, tracks_of
from tossid.types import PoseTrack

Array = NDArray[np.float64]

MISMATCH = 0.5
"""Largest relative difference, in the median, between recorded velocities and the differences of the poses."""
MOVING = (0.1, 1.0)
"""Speed [m/s] and angular velocity [rad/s] below which a frame says nothing about units."""


def read_tensor(path: Path, columns: Sequence[int]) -> Array:
    """The float tensor (n, columns) or (1, n, columns) that `torch.save` wrote; nothing in the file is executed.

    Args:
        path: The file.
        columns: Numbers of columns that will do.

    Returns:
        (n, columns).

    Raises:
        FileError: It is no tensor file, holds code, or has another shape or type.
    """
    import torch

    budget.check_archive(path)
    try:
        loaded = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch and pickle raise nearly every kind on damaged files
        holds_code = "weights_only" in str(error).lower() or "Unsupported" in str(error)
        code = "holds Python objects or code, expected a plain tensor (nothing in it was executed)"
        damaged = "cannot be read as a tensor file (damaged, or not written by torch.save)"
        raise FileError(path, code if holds_code else damaged) from error
    expected = " or ".join(f"(n, {count})" for count in columns)
    if not isinstance(loaded, torch.Tensor):
        raise FileError(path, f"holds a {type(loaded).__name__}, expected one tensor {expected}")
    if loaded.layout != torch.strided or loaded.dtype not in (torch.float64, torch.float32):
        raise FileError(path, f"holds a tensor of type {loaded.dtype}, expected float64 or float32")
    shape, stored = tuple(loaded.shape), loaded.untyped_storage().nbytes()
    if loaded.numel() * loaded.element_size() > stored:  # with a stride of 0 one number is as many as one likes
        raise FileError(path, f"claims a tensor of shape {shape}, more than its {stored} stored bytes can hold")
    rows = loaded[0] if loaded.ndim == 3 and shape[0] == 1 else loaded
    if rows.ndim != 2 or rows.shape[1] not in columns or rows.shape[0] < 2:
        raise FileError(path, f"holds a tensor of shape {shape}, expected {expected} with n >= 2")
    return np.array(rows.detach().numpy(), dtype=float)


def tensor_tracks(folder: Path, read: Callable[[Path], tuple[Array, Array]], *, rate_hz: float) -> Sequence[PoseTrack]:
    """The tracks of a folder of `.pt` files, one a toss, with recorded velocities.

    Args:
        folder: Where they lie.
        read: Reads a file: configurations (n, nq) and velocities (n, nv).
        rate_hz: Frames a second.

    Returns:
        The tracks, 2 before 10.

    Raises:
        FileError: A file or the folder is not what it should be; names file and row.
        InputError: The rate is not positive.
    """
    if not (np.isfinite(rate_hz) and rate_hz > 0):
        raise InputError(f"the rate is {rate_hz} Hz, expected a positive number")

    def track(path: Path) -> PoseTrack:
        q, v = read(path)
        return checked_track(path, np.arange(len(q)) / rate_hz, q, v)

    tracks = tracks_of(files_of(folder, ".pt"), track)
    _check_velocities(folder, tracks)
    return tracks


def has_columns(folder: Path, columns: Sequence[int]) -> bool:
    """Whether a folder's first `.pt` file holds a tensor with one of these numbers of columns."""
    if not holds(folder, ".pt"):
        return False
    try:
        read_tensor(files_of(folder, ".pt")[0], columns)
    except FileError:
        return False
    return True


def _check_velocities(folder: Path, tracks: Sequence[PoseTrack]) -> None:
    """Refuse recorded velocities that disagree with the poses' differences, in the median over all frames.

    This catches lengths of one of the two in other units, a wrong rate, quaternions in another order and angular
    velocities in another frame. Single frames may disagree: recordings have glitches.
    """
    linear, angular = _mismatches(tracks)
    what, mismatch, hint = "velocities", linear, "lengths or rate in other units?"
    if linear <= MISMATCH:
        what, mismatch, hint = "angular velocities", angular, "quaternion order, frame or rate?"
        if angular > MISMATCH and _mismatches(tracks, xyzw_to_wxyz)[1] < MISMATCH:
            hint = "quaternion order? they look like qx qy qz qw: read so, they agree"
    if mismatch > MISMATCH:
        raise FileError(folder, f"recorded {what} disagree with the poses by {mismatch:.0%} in the median; {hint}")


def _mismatches(
    tracks: Sequence[PoseTrack], reordered: Callable[[Array], Array] = lambda quat: quat
) -> tuple[float, ...]:
    """Relative differences, in the median over moving frames, of velocities and of angular velocities.

    reordered: makes wxyz of the tracks' quaternions.
    """
    mismatches: tuple[list[Array], list[Array]] = ([], [])
    for track in tracks:
        assert track.v is not None
        dt, quat = np.diff(track.t)[:, None], reordered(track.q[:, 3:7])
        moved = np.diff(track.q[:, :3], axis=0) / dt, quat_boxminus(quat[1:], quat[:-1]) / dt
        recorded = np.split(0.5 * (track.v[1:, :6] + track.v[:-1, :6]), 2, axis=1)
        for a, b, least, of_kind in zip(moved, recorded, MOVING, mismatches, strict=True):
            size = np.maximum(np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1))
            moving = size > least
            of_kind.append(np.linalg.norm(a - b, axis=1)[moving] / size[moving])
    frames = [np.concatenate(of_kind) for of_kind in mismatches]
    return tuple(float(np.median(each)) if len(each) else 0.0 for each in frames)
