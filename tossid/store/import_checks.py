"""What every importer checks: folders, tensors, and units that cannot be right."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tossid import budget
from tossid.errors import FileError, InputError, MotionError
from tossid.rotations import quat_boxminus, quat_normalize, xyzw_to_wxyz
from tossid.settings.limits import ImportLimits
from tossid.store.hashing import natural_key
from tossid.store.importers.registry import holds
from tossid.types import OnDemand, PoseTrack

Array = NDArray[np.float64]

KEPT = 1024
"""Tracks of a folder that stay in memory; the others are read again when they are asked for again."""
DEFAULT_LIMITS = ImportLimits()


def files_of(folder: Path, suffix: str, *, but_not: tuple[str, ...] = ()) -> list[Path]:
    """The files of a folder that end with a suffix, 2 before 10.

    Args:
        folder: Where they lie.
        suffix: End of their names.
        but_not: Longer suffixes of files to leave out.

    Returns:
        Their paths, at least one.

    Raises:
        FileError: There is no such folder, or no such file in it.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileError(folder, f"no such folder; expected a folder of *{suffix} files, one a toss")
    found = [path for path in folder.iterdir() if path.name.endswith(suffix) and path.is_file()]
    found = [path for path in found if not path.name.endswith(but_not)]
    if not found:
        raise FileError(folder, f"holds no *{suffix} file; expected one a toss")
    return sorted(found, key=lambda path: natural_key(path.name))


def tracks_of(files: Sequence[Path], read: Callable[[Path], PoseTrack]) -> Sequence[PoseTrack]:
    """The tracks of files, each read when it is asked for.

    Args:
        files: One a track.
        read: Reads one of them.

    Returns:
        The tracks, in the order of the files.
    """
    return OnDemand(lambda i: read(files[i]), len(files), kept=KEPT)


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
    stored = loaded.untyped_storage().nbytes()
    if loaded.numel() * loaded.element_size() > stored:  # with a stride of 0 one number is as many as one likes
        raise FileError(path, f"claims a tensor of shape {shape}, more than its {stored} stored bytes can hold")
    if loaded.ndim == 3 and shape[0] == 1:
        loaded = loaded[0]
    if loaded.ndim != 2 or loaded.shape[1] not in columns or loaded.shape[0] < 2:
        raise FileError(path, f"holds a tensor of shape {shape}, expected {want} with n >= 2")
    return np.array(loaded.detach().numpy(), dtype=float)


def tensor_tracks(
    folder: Path, read: Callable[[Path], tuple[Array, Array]], *, rate_hz: float, limits: ImportLimits = DEFAULT_LIMITS
) -> Sequence[PoseTrack]:
    """The tracks of a folder of `.pt` files, one a toss, with recorded velocities.

    Args:
        folder: Where they lie.
        read: Reads a file: configurations (n, nq) and velocities (n, nv).
        rate_hz: Frames a second.
        limits: Values beyond which units are taken to be wrong.

    Returns:
        The tracks, 2 before 10.

    Raises:
        FileError: A file or the folder is not what it should be; names file and row.
        InputError: The rate is not positive.
    """
    check_rate(rate_hz)

    def track(path: Path) -> PoseTrack:
        q, v = read(path)
        return checked_track(path, np.arange(len(q)) / rate_hz, q, v, limits=limits)

    tracks = tracks_of(files_of(folder, ".pt"), track)
    check_velocities(folder, tracks, limits=limits)
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


def checked_track(
    path: Path,
    t: Array,
    q: Array,
    v: Array | None,
    *,
    row_names: Sequence[str] | None = None,
    limits: ImportLimits = DEFAULT_LIMITS,
) -> PoseTrack:
    """A track named after its file, whose quaternions (unit within 1e-3) are normalised.

    Args:
        path: The file that the values come from.
        t: (n,) times [s].
        q: (n, nq) configurations [m, quaternion wxyz, rad]; normalised in place.
        v: (n, nv) velocities, None where the file has none.
        row_names: What to call the frames in errors; their index if None.
        limits: Values beyond which units are taken to be wrong.

    Returns:
        The track.

    Raises:
        FileError: The values are no motion, or beyond the limits; names the row.
    """

    def row_of(row: int) -> int | str:
        return row if row_names is None else row_names[row]

    check_times(path, t, limits)
    try:
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            track = PoseTrack(name=path.stem, t=t, q=q, v=v)
    except MotionError as error:
        row = None if error.row is None else row_of(error.row)
        raise FileError(path, error.problem, row=row) from error
    q[:, 3:7] = quat_normalize(q[:, 3:7])
    checks = [("position", np.abs(q[:, :3]).max(axis=1), limits.position, "m")]
    if v is not None:
        checks += [
            ("speed", np.linalg.norm(v[:, :3], axis=1), limits.speed, "m/s"),
            ("angular velocity", np.abs(v[:, 3:]).max(axis=1), limits.spin, "rad/s"),
        ]
    for what, values, limit, unit in checks:
        if (values > limit).any():
            row = int(np.argmax(values > limit))
            raise FileError(
                path, f"{what} {values[row]:.4g} {unit} is beyond {limit:g}; are the units right?", row=row_of(row)
            )
    return track


def check_times(path: Path, t: Array, limits: ImportLimits = DEFAULT_LIMITS) -> None:
    """Raise `FileError` where the times of frames cannot be seconds; asks for the unit that they may have.

    Args:
        path: The file that they come from.
        t: (n,) times.
        limits: Least and largest time between frames.

    Raises:
        FileError: Frames are too close, or too far apart.
    """
    steps, (least, most) = np.diff(t), limits.step
    step = float(np.median(steps)) if len(steps) else 0.0
    # (of few frames nothing is said; times that do not increase are another error)
    if len(steps) < 3 or not np.isfinite(step) or step <= 0 or least <= step <= most:
        return
    unit = next((name for name, size in (("ms", 1e-3), ("µs", 1e-6)) if least <= step * size <= most), "ns")
    guess = "seconds, not hours or days" if step < least else "frame numbers" if (steps == 1).all() else f"in {unit}"
    raise FileError(
        path,
        f"frames are {step:.3g} s apart (median), and it is {t[-1] - t[0]:.4g} s long; are the times {guess}? A header "
        "that names the column's unit says so, such as time_ms",
    )


def check_velocities(folder: Path, tracks: Sequence[PoseTrack], *, limits: ImportLimits = DEFAULT_LIMITS) -> None:
    """Raise `FileError` unless recorded velocities agree with the poses' differences, in the median over all frames.

    This catches lengths of one of the two in other units, a wrong rate, quaternions in another order and angular
    velocities in another frame. Single frames may disagree: recordings have glitches.

    Args:
        folder: Where the tracks come from.
        tracks: With recorded velocities.
        limits: Smallest motion that counts, and largest disagreement.

    Raises:
        FileError: They disagree by more.
    """
    kinds = (
        ("velocities", limits.moving_speed, "lengths or rate in other units?"),
        ("angular velocities", limits.moving_spin, "quaternion order, frame or rate?"),
    )
    for (what, _, hint), mismatch in zip(kinds, _mismatches(tracks, kinds), strict=True):
        if mismatch > limits.mismatch:
            if what != "velocities" and _mismatches(tracks, kinds, xyzw_to_wxyz)[1] < limits.mismatch:
                hint = "quaternion order? they look like qx qy qz qw: read so, they agree"
            raise FileError(folder, f"recorded {what} disagree with the poses by {mismatch:.0%} in the median; {hint}")


def _mismatches(
    tracks: Sequence[PoseTrack],
    kinds: Sequence[tuple[str, float, str]],
    reordered: Callable[[Array], Array] = lambda quat: quat,
) -> list[float]:
    """Relative differences, in the median over moving frames, of velocities and of angular velocities.

    reordered: makes wxyz of the tracks' quaternions.
    """
    mismatches: list[list[Array]] = [[] for _ in kinds]
    for track in tracks:
        assert track.v is not None
        dt, quat = np.diff(track.t)[:, None], reordered(track.q[:, 3:7])
        moved = np.diff(track.q[:, :3], axis=0) / dt, quat_boxminus(quat[1:], quat[:-1]) / dt
        recorded = np.split(0.5 * (track.v[1:, :6] + track.v[:-1, :6]), 2, axis=1)
        for a, b, (_, least, _), of_kind in zip(moved, recorded, kinds, mismatches, strict=True):
            size = np.maximum(np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1))
            moving = size > least
            of_kind.append(np.linalg.norm(a - b, axis=1)[moving] / size[moving])
    frames = [np.concatenate(of_kind) for of_kind in mismatches]
    return [float(np.median(each)) if len(each) else 0.0 for each in frames]


def check_rate(rate_hz: float) -> None:
    """Raise `InputError` unless the rate is a positive number."""
    if not (np.isfinite(rate_hz) and rate_hz > 0):
        raise InputError(f"the rate is {rate_hz} Hz, expected a positive number")
