"""Detections and poses of a long recording, kept in temporary files because they may not fit into memory.

The files have no name and are gone with the process, however that ends. The caller says in which folder they lie, since
the system's temporary one may be memory, too.
"""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np

from tossid.errors import MotionError
from tossid.types import Detection, LongTrack, PoseTrack

ROW = np.dtype(
    [
        ("camera", "i4"),
        ("t", "f8"),
        ("tag_id", "i8"),
        ("corners", "f8", (4, 2)),
        ("corner_cov", "f8", (4, 2, 2)),
        ("hamming", "i8"),
        ("margin", "f8"),
    ]
)
"""One detection in the file."""
AT_ONCE = 512
"""Detections that are written or read at once."""


@contextmanager
def pose_spool(folder: Path) -> Iterator[PoseSpool]:
    """A temporary file for poses, while the block lasts.

    Args:
        folder: Where the file lies.
    """
    with tempfile.TemporaryFile(dir=folder) as file:
        yield PoseSpool(file)


@contextmanager
def detections_aside(detections: Iterable[Detection], folder: Path | None) -> Iterator[SpooledDetections]:
    """Detections in a temporary file, which can be read again and again while the block lasts.

    Args:
        detections: All of them are taken at once.
        folder: Where the file lies; None: in the system's folder for temporary files.
    """
    with tempfile.TemporaryFile(dir=folder) as file:
        yield SpooledDetections(detections, file)


class SpooledDetections(Iterable[Detection]):
    """Detections in a file; see `detections_aside`."""

    def __init__(self, detections: Iterable[Detection], file: BinaryIO) -> None:
        """Write detections to an open file."""
        self._file, self._cameras = file, dict[str, int]()
        self.count = 0
        source = iter(detections)
        while some := list(itertools.islice(source, AT_ONCE)):
            rows = np.empty(len(some), dtype=ROW)
            for i, d in enumerate(some):
                camera = self._cameras.setdefault(d.camera, len(self._cameras))
                rows[i] = camera, d.t, d.tag_id, d.corners, d.corner_cov, d.hamming, d.margin
            file.write(rows.tobytes())
            self.count += len(some)

    def __iter__(self) -> Iterator[Detection]:
        """The detections, from the first."""
        names = list(self._cameras)
        for first in range(0, self.count, AT_ONCE):
            self._file.seek(first * ROW.itemsize)
            rows = np.frombuffer(self._file.read(min(AT_ONCE, self.count - first) * ROW.itemsize), dtype=ROW)
            for camera, t, tag_id, corners, cov, hamming, margin in rows:
                yield Detection(
                    names[camera], float(t), int(tag_id), corners.copy(), cov.copy(), int(hamming), float(margin)
                )


class PoseSpool:
    """The stretches of a track, one after another, in a file; see `pose_spool`."""

    def __init__(self, file: BinaryIO) -> None:
        """Keep a track in an open file."""
        self._file = file
        self._shape: tuple[str, int, int] | None = None
        self._t: list[np.ndarray] = []

    def add(self, part: PoseTrack) -> None:
        """Append the next stretch; all stretches have covariances, or none has."""
        shape = part.name, part.q.shape[1], 0 if part.q_cov is None else part.q_cov.shape[1]
        if self._shape not in (None, shape):
            raise MotionError(f"a track goes on with other columns ({shape}, expected {self._shape})")
        if self._t and part.t[0] <= self._t[-1][-1]:
            raise MotionError(f"time does not increase ({self._t[-1][-1]:.9g} s, then {part.t[0]:.9g} s)")
        self._shape = shape
        cov = np.zeros((len(part.t), 0)) if part.q_cov is None else part.q_cov.reshape(len(part.t), -1)
        self._file.seek(0, 2)
        self._file.write(np.hstack([part.q, cov]).tobytes())
        self._t.append(part.t.copy())

    def track(self) -> LongTrack | None:
        """The whole track, to be read while the spool is open; None if there is none."""
        if self._shape is None:
            return None
        t, (name, nq, nv) = np.concatenate(self._t), self._shape
        width = nq + nv * nv

        def read(which: slice) -> PoseTrack:
            first, last, _ = which.indices(len(t))
            self._file.seek(8 * width * first)
            rows = np.frombuffer(self._file.read(8 * width * (last - first))).reshape(-1, width)
            cov = rows[:, nq:].reshape(-1, nv, nv).copy() if nv else None
            return PoseTrack(name, t[which], rows[:, :nq].copy(), cov)

        return LongTrack(name, t, read)
