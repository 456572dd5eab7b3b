"""The format `contactnets`: tosses as the ContactNets authors publish them (contact-nets, `data/tosses_processed`)."""

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

COLUMNS = 19
"""Position (3), quaternion wxyz (4), velocity (3), angular velocity (3, body), unused (6)."""

LOWEST_CENTER = (0.7, 5.0)
"""Half widths: where the lowest point of the cube's centre must lie, in the median over tosses. A cube
that comes to rest has its centre at 1 (on a face) to sqrt(3) (on a corner)."""


HALF_WIDTH = 0.0524
"""Half of the published cube's width [m]."""
RATE = 148.0
"""Frames a second of the published recordings [Hz]."""


@dataclass(frozen=True, kw_only=True)
class ContactNetsSource:
    """Tosses of the ContactNets cube as published: N.pt files in half widths."""

    name: Literal["contactnets"] = "contactnets"
    """ContactNets' tensors"""
    path: Path
    """folder of N.pt files"""
    half_width: Positive = HALF_WIDTH
    """half of the cube's width, the file's unit of length [m]"""
    rate_hz: Positive = RATE
    """frames a second"""


def read_contactnets(folder: Path, *, half_width: float = HALF_WIDTH, rate_hz: float = RATE) -> Sequence[PoseTrack]:
    """The tracks in a folder of `N.pt`, each a tensor (1, n, 19) or (n, 19), with lengths in half widths of the cube.

    Args:
        folder: Where the files lie.
        half_width: Half of the cube's width [m]; it scales positions and velocities.
        rate_hz: Frames a second.

    Returns:
        Tracks with recorded velocities, 2 before 10: position [m] and linear velocity [m/s] in the world frame,
        angular velocity [rad/s] in the body frame.

    Raises:
        FileError: A file or the folder is not what it should be; names file and row.
        InputError: The half width or the rate is not positive.
    """
    import numpy as np

    from tossid.store.recorded_poses.tensors import read_tensor, tensor_tracks

    if not (np.isfinite(half_width) and half_width > 0):
        raise InputError(f"the half width is {half_width} m, expected a positive number")

    def read(path: Path) -> tuple[Array, Array]:
        rows = read_tensor(path, (COLUMNS,))
        q = np.concatenate([half_width * rows[:, :3], rows[:, 3:7]], axis=1)
        v = np.concatenate([half_width * rows[:, 7:10], rows[:, 10:13]], axis=1)
        return q, v

    tracks = tensor_tracks(folder, read, rate_hz=rate_hz)
    lowest = float(np.median([track.q[:, 2].min() for track in tracks])) / half_width
    if not LOWEST_CENTER[0] < lowest < LOWEST_CENTER[1]:
        raise FileError(
            folder,
            f"the cube's centre comes down to {lowest:.3g} half widths (median), expected between 1 and 1.7; "
            "are the lengths in half widths?",
        )
    return tracks


def _import(source: ContactNetsSource, model: ObjectModel) -> Imported:
    tracks = read_contactnets(source.path, half_width=source.half_width, rate_hz=source.rate_hz)
    return Imported(tracks, source.rate_hz)


def _recognizes(path: Path) -> bool:
    from tossid.store.recorded_poses.tensors import has_columns

    return has_columns(path, (COLUMNS,))


register_importer(ContactNetsSource, _import, recognizes=_recognizes)
