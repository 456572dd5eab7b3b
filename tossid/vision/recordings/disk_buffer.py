"""Detections and poses of a long recording, kept in temporary files because they may not fit into memory.

The caller opens them with `tempfile.TemporaryFile`, so that they have no name and are gone with the process, however
that ends; in a folder of its own, since the system's temporary one may be memory, too.
"""

from __future__ import annotations

import itertools
import pickle
from collections.abc import Iterable, Iterator
from typing import BinaryIO

import numpy as np

from tossid.errors import MotionError
from tossid.types import Detection, LongTrack, PoseTrack

AT_ONCE = 512
"""Detections that are written or read at once."""


class DetectionSpool(Iterable[Detection]):
    """Detections in a temporary file, to be gone through again and again while that is open."""

    def __init__(self, detections: Iterable[Detection], file: BinaryIO) -> None:
        """Write all detections to a file."""
        self._file, source = file, iter(detections)
        while some := list(itertools.islice(source, AT_ONCE)):
            pickle.dump(some, file)
        self._end = file.tell()

    def __iter__(self) -> Iterator[Detection]:
        """The detections, from the first."""
        at = 0
        while at < self._end:
            self._file.seek(at)
            some = pickle.load(self._file)
            at = self._file.tell()
            yield from some


class PoseSpool:
    """The stretches of a track, one after another, in a temporary file."""

    def __init__(self, file: BinaryIO) -> None:
        """Keep a track in a file, while that is open."""
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
