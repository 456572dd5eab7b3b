"""Locks between commands, on file systems with `flock` and on those without.

With `flock`, the system releases a lock when its holder dies. Some network file systems refuse it (ENOSYS, EOPNOTSUPP,
ENOLCK). There, a lock is a file that names its owner. It is taken over when the owner has died on this machine. An
owner on another machine cannot be asked, so its lock holds until its file is removed.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

_NO_FLOCK = (errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP, errno.ENOLCK)
_POLL_S = 0.1
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
    try:
        release = _by_flock(lock, wait)
    except OSError as error:
        if error.errno not in _NO_FLOCK:
            raise
        lock.unlink(missing_ok=True)
        release = _by_owner(lock.with_name(lock.name + OWNED), wait)
    try:
        yield
    finally:
        release()


def _by_flock(lock: Path, wait: bool) -> Callable[[], None]:
    """Take the lock from the system; returns what gives it back."""
    while True:
        handle = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            if _is_at(handle, lock):  # another holder may have removed the file between our open and our lock
                break
        except OSError as error:
            holder = os.read(handle, 32).decode(errors="replace").strip()
            os.close(handle)
            if error.errno not in (errno.EAGAIN, errno.EWOULDBLOCK):
                raise
            raise LockHeld(f"process {holder}" if holder else "another process") from None
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)

    def release() -> None:
        lock.unlink(missing_ok=True)
        os.close(handle)

    try:
        os.ftruncate(handle, 0)
        os.write(handle, f"{os.getpid()}\n".encode())
    except BaseException:
        release()
        raise
    return release


def _is_at(handle: int, path: Path) -> bool:
    """Whether an open file is still the one at a path."""
    try:
        return os.stat(path).st_ino == os.fstat(handle).st_ino
    except FileNotFoundError:
        return False


# ---------------------------------------------------------------- without flock


def _by_owner(lock: Path, wait: bool) -> Callable[[], None]:
    """Take the lock by making a file that must not be there; returns what gives it back."""
    while True:
        try:
            handle = os.open(lock, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        except FileExistsError:
            _take_from_the_dead(lock)
            if not lock.exists():
                continue
            if not wait:
                raise LockHeld(_named(_owner_in(lock), lock)) from None
            time.sleep(_POLL_S)
            continue
        try:
            with os.fdopen(handle, "w") as file:
                json.dump(_process(os.getpid()), file)
        except BaseException:
            lock.unlink(missing_ok=True)
            raise
        return lambda: lock.unlink(missing_ok=True)


def _process(pid: int) -> dict[str, str | int]:
    """What tells a process of this machine from every other, also from one that gets its number later."""
    return {
        "host": socket.gethostname(),
        "boot": _read("/proc/sys/kernel/random/boot_id"),
        "space": _namespace(),
        "pid": pid,
        "started": _started(pid),
    }


def _namespace() -> str:
    """In which numbers of processes mean something: a container has its own."""
    try:
        return os.readlink("/proc/self/ns/pid")
    except OSError:
        return ""


def _started(pid: int) -> str:
    """When a process started, in ticks since the system did; "" if there is no such process."""
    fields = _read(f"/proc/{pid}/stat").rpartition(")")[2].split()
    return fields[19] if len(fields) > 19 else ""


def _read(path: str) -> str:
    try:
        return Path(path).read_text().strip()
    except OSError:
        return ""


def _owner_in(lock: Path) -> dict[str, str | int]:
    try:
        found = json.loads(lock.read_text())
        return {name: found[name] for name in ("host", "boot", "space", "pid", "started")}
    except (OSError, ValueError, KeyError, TypeError):  # it is being written or removed
        return {}


def _take_from_the_dead(lock: Path) -> None:
    """Remove the lock of an owner that has died on this machine."""
    owner = _owner_in(lock)
    if not owner:
        return
    now = _process(int(owner["pid"]))
    elsewhere = owner["host"] != now["host"] or (owner["boot"] == now["boot"] and owner["space"] != now["space"])
    if elsewhere or owner == now:
        return
    aside = lock.with_name(f"{lock.name}.{os.getpid()}")
    try:
        os.rename(lock, aside)
    except FileNotFoundError:
        return
    if _owner_in(aside) != owner:  # another process was faster, and holds it now
        os.rename(aside, lock)
    else:
        aside.unlink()


def _named(owner: dict[str, str | int], lock: Path) -> str:
    who = f"process {owner['pid']} on {owner['host']}" if owner else "another process"
    return f"{who}; if that is dead, remove {lock}"
