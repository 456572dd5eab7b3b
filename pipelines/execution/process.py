"""What a command sets for its process for a while: how it takes signals, and variables that it and others read."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import FrameType


@contextmanager
def interruptible() -> Iterator[None]:
    """Let SIGTERM and a closed terminal stop a command as Ctrl-C does, so that it cleans up."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    default = [number for number in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(number) == signal.SIG_DFL]
    with _handled(default, stop):
        yield


@contextmanager
def interrupted_later() -> Iterator[None]:
    """Let Ctrl-C, SIGTERM and a closed terminal wait until the end; then they stop the command as Ctrl-C does.

    Raises:
        KeyboardInterrupt: At the end, if one of them came.
    """
    came: list[int] = []
    with _handled([signal.SIGINT, signal.SIGTERM, signal.SIGHUP], lambda number, frame: came.append(number)):
        yield
    if came:
        raise KeyboardInterrupt


@contextmanager
def _handled(numbers: Sequence[int], handler: Callable[[int, FrameType | None], object]) -> Iterator[None]:
    """Handle signals while the block lasts; only the main thread can, and gets them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, signal.SIG_DFL if earlier is None else earlier)


@contextmanager
def environment(values: Mapping[str, str]) -> Iterator[None]:
    """Set variables while the block lasts; processes that are started within inherit them.

    Args:
        values: By name.
    """
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
