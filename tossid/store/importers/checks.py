"""What every importer checks: folders, tensors, and units that cannot be right."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tossid.errors import FileError, InputError, MotionError
from tossid.rotations import quat_boxminus, quat_normalize
from tossid.store.hashing import natural_key
from tossid.types import OnDemand, PoseTrack

Array = NDArray[np.float64]

KEPT = 1024
"""Tracks of a folder that stay in memory; more are read again when they are asked for again."""
MAX_POSITION = 20.0
"""[m] from the origin: tosses are room-sized."""
MAX_SPEED = 50.0
"""[m/s]"""
MAX_SPIN = 200.0
"""[rad/s] of the body, and of a joint."""
MAX_MISMATCH = 0.5
"""Relative: how far recorded velocities may be, in the median, from the differences of the poses."""
MIN_MOVING_SPEED = 0.1
"""[m/s] below which a frame says nothing about units."""
MIN_MOVING_SPIN = 1.0
"""[rad/s] below which a frame says nothing about units."""


def files_of(folder: Path, suffix: str, *, but_not: str | None = None) -> list[Path]:
    """The folder's files with a suffix, 2 before 10.

    Args:
        but_not: longer suffix of files to leave out.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileError(folder, f"no such folder; expected a folder of *{suffix} files, one a toss")
    found = [path for path in folder.iterdir() if path.name.endswith(suffix) and path.is_file()]
    if but_not is not None:
        found = [path for path in found if not path.name.endswith(but_not)]
    if not found:
        raise FileError(folder, f"holds no *{suffix} file; expected one a toss")
    return sorted(found, key=lambda path: natural_key(path.name))


def tracks_of(files: Sequence[Path], read: Callable[[Path], PoseTrack]) -> Sequence[PoseTrack]:
    """A track of each file, read when it is asked for."""
    return OnDemand(lambda i: read(files[i]), len(files), kept=KEPT)


def read_tensor(path: Path, columns: Sequence[int]) -> Array:
    """A (n, columns) or (1, n, columns) float tensor that `torch.save` wrote; nothing in it is executed.

    Raises:
        FileError: it is no tensor file, holds code, or has another shape or type.
    """
    import torch

    try:
        loaded = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch and pickle raise nearly every kind on damaged files
        text = str(error)
        if "weights_only" in text.lower() or "Unsupported" in text:
            problem = "holds Python objects or code, expected a plain tensor (nothing in it was executed)"
        else:
            problem = "cannot be read as a tensor file (damaged, or not written by torch.save)"
        raise FileError(path, problem) from error
    want = " or ".join(f"(n, {count})" for count in columns)
    if not isinstance(loaded, torch.Tensor):
        raise FileError(path, f"holds a {type(loaded).__name__}, expected one tensor {want}")
    if loaded.layout != torch.strided or loaded.dtype not in (torch.float64, torch.float32):
        raise FileError(path, f"holds a tensor of type {loaded.dtype}, expected float64 or float32")
    shape = tuple(loaded.shape)
    if loaded.ndim == 3 and shape[0] == 1:
        loaded = loaded[0]
    if loaded.ndim != 2 or loaded.shape[1] not in columns or loaded.shape[0] < 2:
        raise FileError(path, f"holds a tensor of shape {shape}, expected {want} with n >= 2")
    return np.array(loaded.detach().numpy(), dtype=float)


def checked_track(
    path: Path, t: Array, q: Array, v: Array | None, *, row_names: Sequence[str] | None = None
) -> PoseTrack:
    """A `PoseTrack` named after the file, its quaternions (unit within 1e-3) normalised; errors name file and row.

    Args:
        row_names: what to call the frames in errors; their index if None.
    """

    def row_of(row: int) -> int | str:
        return row if row_names is None else row_names[row]

    try:
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            track = PoseTrack(name=path.stem, t=t, q=q, v=v)
    except MotionError as error:
        row = None if error.row is None else row_of(error.row)
        raise FileError(path, error.problem, row=row) from error
    q[:, 3:7] = quat_normalize(q[:, 3:7])
    limits = [("position", np.abs(q[:, :3]).max(axis=1), MAX_POSITION, "m")]
    if v is not None:
        limits += [
            ("speed", np.linalg.norm(v[:, :3], axis=1), MAX_SPEED, "m/s"),
            ("angular velocity", np.abs(v[:, 3:]).max(axis=1), MAX_SPIN, "rad/s"),
        ]
    for what, values, limit, unit in limits:
        if (values > limit).any():
            row = int(np.argmax(values > limit))
            raise FileError(
                path, f"{what} {values[row]:.4g} {unit} is beyond {limit:g}; are the units right?", row=row_of(row)
            )
    return track


def check_velocities(folder: Path, tracks: Sequence[PoseTrack]) -> None:
    """Raise `FileError` unless recorded velocities are the poses' own, in the median over all frames.

    It catches wrong length units of one of the two, a wrong rate, quaternions
    in another order and angular velocities in another frame. Single frames may
    be off: recordings have glitches.
    """
    cases = (
        ("velocities", MIN_MOVING_SPEED, "lengths or rate in other units?"),
        ("angular velocities", MIN_MOVING_SPIN, "quaternion order, frame or rate?"),
    )
    misses: list[list[Array]] = [[] for _ in cases]
    for track in tracks:
        assert track.v is not None
        dt = np.diff(track.t)[:, None]
        moved = np.diff(track.q[:, :3], axis=0) / dt, quat_boxminus(track.q[1:, 3:7], track.q[:-1, 3:7]) / dt
        recorded = np.split(0.5 * (track.v[1:, :6] + track.v[:-1, :6]), 2, axis=1)
        for a, b, (_, least, _), of_case in zip(moved, recorded, cases, misses, strict=True):
            size = np.maximum(np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1))
            moving = size > least
            of_case.append(np.linalg.norm(a - b, axis=1)[moving] / size[moving])
    for (what, _, hint), of_case in zip(cases, misses, strict=True):
        all_of_them = np.concatenate(of_case)
        off = float(np.median(all_of_them)) if len(all_of_them) else 0.0
        if off > MAX_MISMATCH:
            raise FileError(folder, f"recorded {what} disagree with the poses by {off:.0%} in the median; {hint}")


def check_rate(rate_hz: float) -> None:
    """Raise `InputError` unless the rate is a positive number."""
    if not (np.isfinite(rate_hz) and rate_hz > 0):
        raise InputError(f"the rate is {rate_hz} Hz, expected a positive number")
