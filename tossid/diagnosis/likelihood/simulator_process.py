"""A user's own simulator, run in its own process. A crash, a hang, NaNs and a wrong shape are each one clear error.

The simulator is a function f(q0, v0, n_steps, dt) -> (q, v) over a batch. It is in a Python file that the user names,
or the calling program holds it. For the latter the process is forked from this one, so that functions of a notebook and
closures serve too. Arrays pass through a pipe; nothing is unpickled.
"""

from __future__ import annotations

import importlib.util
import multiprocessing
import os
import signal
import sys
import threading
import time
import traceback
import weakref
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.settings.limits import VALUES

Array = NDArray[np.float64]
BatchFunction = Callable[[Array, Array, int, float], tuple[Array, Array]]
"""(q0 (B, nq), v0 (B, nv), n_steps, dt) -> q (B, n_steps + 1, nq), v (B, n_steps + 1, nv), first states included."""

_FIRST_STATE = 1e-3
"""Difference of a first state that is returned to the one that was given, from which it is not the same."""
_RESULT, _PROBLEM = b"R", b"P"
_LOOK_S = 1.0
"""Time after which a process looks again whether its parent is still there [s]."""


@dataclass(frozen=True)
class FromFile:
    """A function in a Python file.

    Attributes:
        path: The file.
        function: The function's name.
    """

    path: Path
    function: str

    def load(self) -> BatchFunction:
        """The function.

        Raises:
            InputError: The file has no such function.
        """
        spec = importlib.util.spec_from_file_location("users_simulator", self.path)
        if spec is None or spec.loader is None:
            raise InputError(f"{self.path}: is no Python file")
        sys.path.insert(0, str(self.path.parent.resolve()))
        module = importlib.util.module_from_spec(spec)
        sys.modules[spec.name] = module
        spec.loader.exec_module(module)
        found = getattr(module, self.function, None)
        if not callable(found):
            raise InputError(f"{self.path}: has no function '{self.function}'")
        made: BatchFunction = found
        return made


@dataclass(frozen=True)
class Given:
    """A function that the calling program holds.

    Attributes:
        function: The function.
    """

    function: BatchFunction

    def load(self) -> BatchFunction:
        """The function."""
        return self.function


class SimulatorProcess:
    """A user's simulator in a process of its own, which starts with the first call.

    Called from several threads, it answers one after another.

    Attributes:
        frames: How many it has been asked for.
    """

    def __init__(self, source: FromFile | Given, *, about: str, seconds: float) -> None:
        """Nothing is started yet.

        Args:
            source: Where the function comes from.
            about: The simulator in words, for errors.
            seconds: Longest that the start or a call may take [s].
        """
        self.source, self.about, self.seconds, self.frames = source, about, seconds, 0
        self._lock = threading.Lock()
        self._process: BaseProcess | None = None
        self._pipe: Connection | None = None

    def __call__(self, q0: Array, v0: Array, n_steps: int, dt: float) -> tuple[Array, Array]:
        """Poses (B, n_steps + 1, nq) and velocities (B, n_steps + 1, nv) from first states.

        Args:
            q0: (B, nq) first configurations: position [m], quaternion wxyz, joints [rad].
            v0: (B, nv) first velocities: linear in the world, angular in the body frame, joint rates.
            n_steps: Frames after the first.
            dt: Between frames [s].

        Raises:
            InputError: The simulator raises, crashes, takes too long, or returns NaN or arrays of another shape.
        """
        with self._lock:
            pipe = self._started()
            self.frames += len(q0) * n_steps
            try:
                pipe.send_bytes(_packed(q0, v0, np.array([n_steps, dt])))
                answer = self._answer(pipe)
            except (EOFError, BrokenPipeError, ConnectionResetError):
                raise InputError(f"{self.about}: {self._death()}, called with {_size(q0, n_steps)}") from None
        q, v = _unpacked(answer)
        self._check(q, v, q0, n_steps)
        return q, v

    def close(self) -> None:
        """End the process; another call would start it anew."""
        with self._lock:
            self._stop()

    def _started(self) -> Connection:
        """The pipe to a process that has loaded the function."""
        if self._pipe is not None and self._process is not None and self._process.is_alive():
            return self._pipe
        self._stop()
        context = multiprocessing.get_context("fork" if isinstance(self.source, Given) else "spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(theirs, self.source, os.getpid()), daemon=True)  # type: ignore[attr-defined]
        process.start()
        theirs.close()
        self._process, self._pipe = process, ours
        weakref.finalize(self, _end, process)
        try:
            self._answer(ours)
        except EOFError:
            raise InputError(f"{self.about}: {self._death()}, while it was loaded") from None
        return ours

    def _answer(self, pipe: Connection) -> bytes:
        """What the process sends next."""
        if not pipe.poll(self.seconds):
            self._stop()
            raise InputError(f"{self.about}: gave no answer within {self.seconds:g} s, and was ended")
        answer = pipe.recv_bytes()
        if answer[:1] == _PROBLEM:
            raise InputError(f"{self.about}: {answer[1:].decode(errors='replace')}")
        return answer[1:]

    def _death(self) -> str:
        """How the process ended, in words."""
        process = self._process
        if process is not None:
            process.join(5.0)
        code = None if process is None else process.exitcode
        self._stop()
        if code is not None and code < 0:
            return f"its process crashed ({signal.Signals(-code).name})"
        return f"its process ended (exit status {code})"

    def _stop(self) -> None:
        if self._process is not None:
            _end(self._process)
        if self._pipe is not None:
            self._pipe.close()
        self._process = self._pipe = None

    def _check(self, q: Array, v: Array, q0: Array, n_steps: int) -> None:
        for name, got in (("q", q), ("v", v)):
            bad = np.flatnonzero(~np.isfinite(got).all(axis=(1, 2)))
            if len(bad):
                frame = int(np.argmin(np.isfinite(got[bad[0]]).all(axis=1)))
                raise InputError(
                    f"{self.about}: returns {name} that is not finite in {len(bad)} of {len(q0)} motions, in row "
                    f"{bad[0]} from frame {frame} of {n_steps} on; its first state is q0 = "
                    f"{np.array2string(q0[bad[0]], precision=4)}"
                )
            largest, limit = np.abs(got).max(), VALUES.position if name == "q" else VALUES.velocity
            if largest > limit:
                raise InputError(f"{self.about}: returns {name} of {largest:.3g}, expected at most {limit:g}")
        length = np.linalg.norm(q[..., 3:7], axis=-1)
        if np.abs(length - 1.0).max() > _FIRST_STATE:
            raise InputError(f"{self.about}: returns quaternions of length {length.min():.4f} to {length.max():.4f}")
        sign = np.sign((q[:, 0, 3:7] * q0[:, 3:7]).sum(-1, keepdims=True))
        begun = np.concatenate([q[:, 0, :3], sign * q[:, 0, 3:7], q[:, 0, 7:]], axis=1)
        off = float(np.abs(begun - q0).max())
        if off > _FIRST_STATE:
            raise InputError(f"{self.about}: returns motions that begin {off:.3g} from the first states it was given")


def _size(q0: Array, n_steps: int) -> str:
    return f"{len(q0)} first states and n_steps = {n_steps}"


def _end(process: BaseProcess) -> None:
    """End a process with all that it has started."""
    if process.is_alive():
        assert process.pid is not None
        with suppress(ProcessLookupError):  # it leads no group yet
            os.killpg(process.pid, signal.SIGKILL)
        process.kill()
    process.join(5.0)


def _end_with_parent(parent: int) -> None:
    """Wait for the end of the parent, which may have been killed, and end this process's group."""
    while os.getppid() == parent:
        time.sleep(_LOOK_S)
    os.killpg(0, signal.SIGKILL)


def _serve(pipe: Connection, source: FromFile | Given, parent: int) -> None:
    """Answer calls until the pipe ends. What the simulator prints goes to standard error."""
    os.setpgid(0, 0)  # Ctrl-C is for the command, and what the simulator starts can be ended with it
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, args=(parent,), daemon=True).start()
    os.dup2(2, 1)
    try:
        function = source.load()
    except InputError as error:
        pipe.send_bytes(_PROBLEM + str(error).encode())
        return
    except BaseException as error:
        pipe.send_bytes(_PROBLEM + f"cannot be loaded: {_brief(error)}".encode())
        return
    pipe.send_bytes(_RESULT)
    while True:
        try:
            request = pipe.recv_bytes()
        except EOFError:
            return
        q0, v0, (n_steps, dt) = _unpacked(request)
        pipe.send_bytes(_called(function, q0, v0, int(n_steps), float(dt)))


def _called(function: BatchFunction, q0: Array, v0: Array, n_steps: int, dt: float) -> bytes:
    """The answer to one call."""
    try:
        answer: Any = function(q0, v0, n_steps, dt)
    except Exception as error:
        return _PROBLEM + f"raises {_brief(error)}".encode()
    try:
        q, v = (np.asarray(each, dtype=float) for each in answer)
    except (TypeError, ValueError):
        return _PROBLEM + f"returns {type(answer).__name__}, expected a pair of arrays (q, v)".encode()
    for name, got, first in (("q", q, q0), ("v", v, v0)):
        wanted = (len(first), n_steps + 1, first.shape[1])
        if got.shape != wanted:
            axes = f"(batch, n_steps + 1, n{name}), the first state included"
            return _PROBLEM + f"returns {name} of shape {got.shape}, expected {wanted}: {axes}".encode()
    return _RESULT + _packed(q, v)


def _packed(*arrays: Array) -> bytes:
    """Arrays of numbers as bytes: of each its number of axes, its shape, and its values."""
    parts = []
    for array in arrays:
        parts += [np.array([array.ndim, *array.shape], dtype=np.int64).tobytes(), np.asarray(array, float).tobytes()]
    return b"".join(parts)


def _unpacked(packed: bytes) -> list[Array]:
    """The arrays of `_packed`."""
    arrays, at = [], 0
    while at < len(packed):
        (axes,) = np.frombuffer(packed, np.int64, 1, at)
        shape = np.frombuffer(packed, np.int64, axes, at + 8)
        size, at = int(np.prod(shape)), at + 8 * (1 + int(axes))
        arrays.append(np.frombuffer(packed, float, size, at).reshape(shape).copy())
        at += 8 * size
    return arrays


def _brief(error: BaseException) -> str:
    """An error with the line of the user's code in which it was raised."""
    last = traceback.extract_tb(error.__traceback__)
    where = f" (line {last[-1].lineno} of {Path(last[-1].filename).name})" if last else ""
    return f"{type(error).__name__}: {error}{where}"
