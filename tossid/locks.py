"""Locks between commands, on file systems with `flock` and on those without.

With `flock` the system releases a lock when its holder dies. Some network file systems refuse it. There a lock is a
file that names its owner; it is taken over from an owner that has died on this machine. An owner on another machine
cannot be asked, so its lock holds until its file is removed.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_NO_FLOCK = (errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP, errno.ENOLCK)
OWNED = ".owned"
"""What the name of a lock file ends in where there is no `flock`."""


class LockHeld(Exception):
    """Another process holds the lock.

    Attributes:
        holder: Who that is, in words.
    """

    def __init__(self, holder: str) -> None:
        super().__init__(holder)
        self.holder = holder


@contextmanager
def held(lock: Path, *, wait: bool = False) -> Iterator[None]:
    """Hold a lock.

    Args:
        lock: Its file, which exists as long as the lock is held.
        wait: Whether to wait for another holder.

    Raises:
        LockHeld: Another process holds it, and `wait` is False.
        OSError: The file cannot be made.
    """
    from filelock import BaseFileLock, SoftFileLock, Timeout, UnixFileLock

    owned = lock.with_name(lock.name + OWNED)
    guard: BaseFileLock = UnixFileLock(lock, fallback_to_soft=False)
    try:
        try:
            guard.acquire(timeout=-1 if wait else 0)
        except OSError as error:
            if error.errno not in _NO_FLOCK:
                raise
            lock.unlink(missing_ok=True)
            guard = SoftFileLock(owned)
            guard.acquire(timeout=-1 if wait else 0)
    except Timeout:
        raise LockHeld(_holder(lock, owned)) from None
    try:
        if isinstance(guard, UnixFileLock):
            lock.write_text(f"{os.getpid()}\n")
        yield
    finally:
        if isinstance(guard, UnixFileLock):
            lock.unlink(missing_ok=True)  # while it is held: whoever waits for this file then makes another
        guard.release()


def _holder(lock: Path, owned: Path) -> str:
    """The holder as far as its file tells, and what to do about a dead one that cannot be asked."""
    for path, more in ((lock, ""), (owned, f"; if that is dead, remove {owned}")):
        with suppress(OSError, IndexError):
            pid, *host = path.read_text().split()[:2]
            return f"process {pid}{f' on {host[0]}' if host else ''}{more}"
    return "another process"
