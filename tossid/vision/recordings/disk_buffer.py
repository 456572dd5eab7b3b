"""Detections and poses of a long recording, kept in temporary files because they may not fit into memory.

The files have no name and are gone with the process, however that ends. The caller says in which folder they lie, since
the system's temporary one may be memory, too.
"""

from __future__ import annotations

import itertools
import pickle
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from tossid.errors import MotionError
from tossid.types import Detection, LongTrack, PoseTrack

AT_ONCE = 512
"""Detections that are written or read at once."""


class _Spool:
    """A temporary file, which lasts as long as the context."""

    def __init__(self, folder: Path | None) -> None:
        """Make the file in a folder; None: in the system's for temporary files."""
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  (closed by the context)

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Remove the file."""
        self._file.close()


class DetectionSpool(_Spool, Iterable[Detection]):
    """Detections in a temporary file, to be gone through again and again. Use it as a context."""

    def __init__(self, detections: Iterable[Detection], folder: Path | None) -> None:
        """Take all detections at once; folder: as `_Spool` has it."""
        super().__init__(folder)
        self.count, source = 0, iter(detections)
        while some := list(itertools.islice(source, AT_ONCE)):
            pickle.dump(some, self._file)
            self.count += len(some)
        self._end = self._file.tell()

    def __iter__(self) -> Iterator[Detection]:
        """The detections, from the first."""
        at = 0
        while at < self._end:
            self._file.seek(at)
            some = pickle.load(self._file)
            at = self._file.tell()
            yield from some


class PoseSpool(_Spool):
    """The stretches of a track, one after another, in a temporary file. Use it as a context."""

    def __init__(self, folder: Path) -> None:
        """Keep a track in a file in a folder."""
        super().__init__(folder)
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
