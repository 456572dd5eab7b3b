"""A user's own simulator, run in its own process. A crash, a hang, NaNs and a wrong shape are each one clear error.

The simulator is a function f(q0, v0, n_steps, dt) -> (q, v) over a batch. It is in a Python file that the user names,
or the calling program holds it. For the latter the process is forked from this one, so that functions of a notebook and
closures serve too.
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

FIRST_STATE = 1e-3
"""Difference of a first state that is returned to the one that was given, from which it is not the same."""
LOOK_S = 1.0
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


class SimulatorProcess:
    """A user's simulator in a process of its own, which starts with the first call.

    Called from several threads, it answers one after another.

    Attributes:
        frames: How many it has been asked for.
    """

    def __init__(self, source: FromFile | BatchFunction, *, about: str, seconds: float) -> None:
        """Nothing is started yet.

        Args:
            source: Where the function is, or the function.
            about: The simulator in words, for errors.
            seconds: Longest that the start or a call may take [s].
        """
        self.source, self.about, self.seconds, self.frames = source, about, seconds, 0
        self._lock = threading.Lock()
        self._running: tuple[BaseProcess, Connection] | None = None

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
            if self._running is None or not self._running[0].is_alive():
                self._start()
            self.frames += len(q0) * n_steps
            answer = self._request((q0, v0, n_steps, dt), f"called with {len(q0)} first states and n_steps = {n_steps}")
        q, v = answer
        return q, v

    def close(self) -> None:
        """End the process; another call would start it anew."""
        with self._lock:
            self._stop()

    def _start(self) -> None:
        """A process that has loaded the function."""
        self._stop()
        context = multiprocessing.get_context("spawn" if isinstance(self.source, FromFile) else "fork")
        ours, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(theirs, self.source, os.getpid()), daemon=True)  # type: ignore[attr-defined]
        process.start()
        theirs.close()
        self._running = process, ours
        weakref.finalize(self, _end, process)
        self._request(None, "while it was loaded")

    def _request(self, call: tuple[Array, Array, int, float] | None, when: str) -> Any:
        """The process's answer to a call, or to its start if None."""
        assert self._running is not None
        process, pipe = self._running
        try:
            if call is not None:
                pipe.send(call)
            if not pipe.poll(self.seconds):
                self._stop()
                raise InputError(f"{self.about}: gave no answer within {self.seconds:g} s, and was ended")
            answer = pipe.recv()
        except (EOFError, ConnectionError):
            process.join(5.0)
            code = process.exitcode
            self._stop()
            how = f"crashed ({signal.Signals(-code).name})" if code and code < 0 else f"ended (exit status {code})"
            raise InputError(f"{self.about}: its process {how}, {when}") from None
        if isinstance(answer, str):
            raise InputError(f"{self.about}: {answer}")
        return answer

    def _stop(self) -> None:
        if self._running is not None:
            _end(self._running[0])
            self._running[1].close()
        self._running = None


def _end(process: BaseProcess) -> None:
    """End a process with all that it has started."""
    if process.is_alive():
        assert process.pid is not None
        with suppress(ProcessLookupError):  # it leads no group yet
            os.killpg(process.pid, signal.SIGKILL)
        process.kill()
    process.join(5.0)


# ---------------------------------------------------------------- in the process


def _serve(pipe: Connection, source: FromFile | BatchFunction, parent: int) -> None:
    """Answer calls until the pipe ends: with (q, v), or with what is wrong in words.

    What the simulator prints goes to standard error.
    """
    os.setpgid(0, 0)  # Ctrl-C is for the command, and what the simulator starts can be ended with it
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, args=(parent,), daemon=True).start()
    os.dup2(2, 1)
    try:
        function = source.load() if isinstance(source, FromFile) else source
    except InputError as error:
        pipe.send(str(error))
        return
    except BaseException as error:
        pipe.send(f"cannot be loaded: {_brief(error)}")
        return
    pipe.send(None)
    with suppress(EOFError):
        while True:
            pipe.send(_answer(function, *pipe.recv()))


def _end_with_parent(parent: int) -> None:
    """Wait for the end of the parent, which may have been killed, and end this process's group."""
    while os.getppid() == parent:
        time.sleep(LOOK_S)
    os.killpg(0, signal.SIGKILL)


def _answer(function: BatchFunction, q0: Array, v0: Array, n_steps: int, dt: float) -> tuple[Array, Array] | str:
    """What a function returns, or what is wrong with it."""
    try:
        answer: Any = function(q0, v0, n_steps, dt)
    except Exception as error:
        return f"raises {_brief(error)}"
    try:
        q, v = (np.asarray(each, dtype=float) for each in answer)
    except (TypeError, ValueError):
        return f"returns {type(answer).__name__}, expected a pair of arrays (q, v)"
    for name, got, first, limit in (("q", q, q0, VALUES.position), ("v", v, v0, VALUES.velocity)):
        wanted = (len(first), n_steps + 1, first.shape[1])
        if got.shape != wanted:
            axes = f"(batch, n_steps + 1, n{name}), the first state included"
            return f"returns {name} of shape {got.shape}, expected {wanted}: {axes}"
        finite = np.isfinite(got).all(axis=2)
        if not finite.all():
            row = int(np.argmin(finite.all(axis=1)))
            return (
                f"returns {name} that is not finite in {(~finite.all(axis=1)).sum()} of {len(q0)} motions, in row "
                f"{row} from frame {np.argmin(finite[row])} of {n_steps} on; its first state is q0 = "
                f"{np.array2string(q0[row], precision=4)}"
            )
        if np.abs(got).max() > limit:
            return f"returns {name} of {np.abs(got).max():.3g}, expected at most {limit:g}"
    length = np.linalg.norm(q[..., 3:7], axis=-1)
    if np.abs(length - 1.0).max() > FIRST_STATE:
        return f"returns quaternions of length {length.min():.4f} to {length.max():.4f}"
    sign = np.sign((q[:, 0, 3:7] * q0[:, 3:7]).sum(-1, keepdims=True))
    first = np.concatenate([q[:, 0, :3], sign * q[:, 0, 3:7], q[:, 0, 7:]], axis=1)
    off = float(np.abs(first - q0).max())
    if off > FIRST_STATE:
        return f"returns motions that begin {off:.3g} from the first states it was given"
    return q, v


def _brief(error: BaseException) -> str:
    """An error with the line of the user's code in which it was raised."""
    last = traceback.extract_tb(error.__traceback__)
    where = f" (line {last[-1].lineno} of {Path(last[-1].filename).name})" if last else ""
    return f"{type(error).__name__}: {error}{where}"
