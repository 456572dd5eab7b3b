"""Poses of a long recording, in a file while it is worked on: they may be more than fits into memory."""

from __future__ import annotations

import tempfile
from pathlib import Path
from types import TracebackType

import numpy as np

from tossid.errors import MotionError
from tossid.types import LongTrack, PoseTrack


class PoseSpool:
    """A track's stretches one after another in an unnamed file, which is gone with the process, however that ends.

    Args:
        folder: where the file is to lie. A temporary folder may be memory, too.
    """

    def __init__(self, folder: Path) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  (closed by __exit__)
        self._shape: tuple[str, int, int] | None = None
        self._t: list[np.ndarray] = []

    def __enter__(self) -> PoseSpool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def add(self, part: PoseTrack) -> None:
        """Take the next stretch; all have a covariance of their poses, or none has."""
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
        """All that was taken, to be read while the spool is open; None if nothing was."""
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
