"""Tosses as the ContactNets authors publish them (contact-nets, `data/tosses_processed`)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tossid.errors import FileError, InputError
from tossid.store.importers.checks import check_rate, check_velocities, checked_track, files_of, read_tensor, tracks_of
from tossid.types import PoseTrack

COLUMNS = 19
"""Position (3), quaternion wxyz (4), velocity (3), angular velocity (3, body), unused (6)."""

LOWEST_CENTER = (0.7, 5.0)
"""Half widths: where the lowest point of the cube's centre must lie, in the median over tosses. A cube
that comes to rest has its centre at 1 (on a face) to sqrt(3) (on a corner)."""


def read_contactnets(folder: Path, *, half_width: float = 0.0524, rate_hz: float = 148.0) -> Sequence[PoseTrack]:
    """Read a folder of `N.pt`, each a tensor (1, n, 19) or (n, 19), lengths in half widths of the cube.

    Args:
        half_width: of the cube [m]; it scales positions and velocities.
        rate_hz: frames a second.

    Returns:
        Tracks with recorded velocities, 2 before 10; position and velocity in
        metres and m/s, angular velocity in the body frame [rad/s].

    Raises:
        FileError: a file or the folder is not what it should be; names file and row.
    """
    check_rate(rate_hz)
    if not (np.isfinite(half_width) and half_width > 0):
        raise InputError(f"the half width is {half_width} m, expected a positive number")
    folder = Path(folder)

    def read(path: Path) -> PoseTrack:
        rows = read_tensor(path, (COLUMNS,))
        q = np.concatenate([half_width * rows[:, :3], rows[:, 3:7]], axis=1)
        v = np.concatenate([half_width * rows[:, 7:10], rows[:, 10:13]], axis=1)
        return checked_track(path, np.arange(len(rows)) / rate_hz, q, v)

    tracks = tracks_of(files_of(folder, ".pt"), read)
    check_velocities(folder, tracks)
    lowest = float(np.median([track.q[:, 2].min() for track in tracks])) / half_width
    if not LOWEST_CENTER[0] < lowest < LOWEST_CENTER[1]:
        raise FileError(
            folder,
            f"the cube's centre comes down to {lowest:.3g} half widths (median), expected between 1 and 1.7; "
            "are the lengths in half widths?",
        )
    return tracks
