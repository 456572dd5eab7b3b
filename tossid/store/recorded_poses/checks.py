"""What every importer of tracked poses checks: folders, and numbers whose units cannot be right."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tossid.errors import FileError, MotionError
from tossid.rotations import quat_normalize
from tossid.store.hashing import natural_key
from tossid.types import OnDemand, PoseTrack

Array = NDArray[np.float64]

KEPT = 1024
"""Tracks of a folder that stay in memory; the others are read again when they are asked for again."""
LARGEST = {"position": (20.0, "m"), "speed": (50.0, "m/s"), "angular velocity": (200.0, "rad/s")}
"""Beyond these units are taken to be wrong: tosses are room-sized."""
STEP = (1e-5, 0.2)
"""Least and largest time between frames, in the median [s]: a toss takes some tenths of a second."""


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
    """The tracks of files, in their order, each read when it is asked for."""
    return OnDemand(lambda i: read(files[i]), len(files), kept=KEPT)


def checked_track(
    path: Path, t: Array, q: Array, v: Array | None, *, row_names: Sequence[str] | None = None
) -> PoseTrack:
    """A track named after its file, whose quaternions (unit within 1e-3) are normalised.

    Args:
        path: The file that the values come from.
        t: (n,) times [s].
        q: (n, nq) configurations [m, quaternion wxyz, rad]; normalised in place.
        v: (n, nv) velocities, None where the file has none.
        row_names: What to call the frames in errors; their index if None.

    Raises:
        FileError: The values are no motion, or beyond `LARGEST`; names the row.
    """

    def row_of(row: int) -> int | str:
        return row if row_names is None else row_names[row]

    check_times(path, t)
    try:
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            track = PoseTrack(name=path.stem, t=t, q=q, v=v)
    except MotionError as error:
        row = None if error.row is None else row_of(error.row)
        raise FileError(path, error.problem, row=row) from error
    q[:, 3:7] = quat_normalize(q[:, 3:7])
    sizes = {"position": np.abs(q[:, :3]).max(axis=1)}
    if v is not None:
        sizes |= {"speed": np.linalg.norm(v[:, :3], axis=1), "angular velocity": np.abs(v[:, 3:]).max(axis=1)}
    for what, values in sizes.items():
        limit, unit = LARGEST[what]
        if (values > limit).any():
            row = int(np.argmax(values > limit))
            problem = f"{what} {values[row]:.4g} {unit} is beyond {limit:g}; are the units right?"
            raise FileError(path, problem, row=row_of(row))
    return track


def check_times(path: Path, t: Array) -> None:
    """Refuse times of frames that cannot be seconds; asks for the unit that they may have.

    Args:
        path: The file that they come from.
        t: (n,) times.

    Raises:
        FileError: Frames are closer, or farther apart, than `STEP`.
    """
    steps, (least, most) = np.diff(t), STEP
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
