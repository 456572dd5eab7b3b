"""Outputs that appear whole or not at all, and that only one process writes at a time.

A file or folder is written beside its place under a hidden temporary name, flushed to disk and renamed. Whatever ends
the process before the rename leaves what was there before. A lock beside the output (`tossid.locks`) refuses a second
writer. It ends with its holder, so that a temporary found by the next holder is one that a dead process left.
"""

from __future__ import annotations

import ctypes
import errno
import json
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import BinaryIO

from tossid.errors import InputError, OutputError
from tossid.locks import LockHeld, held

MARKER = ".tossid-output"
"""A file in each output folder of ours: only folders that carry it (or are empty) are ever replaced."""

_TEMPORARY = re.compile(r"\.tmp-\d+-[0-9a-f]{8}(?=\.|$)")
"""What a temporary has in its name."""

_DISK_ERRORS = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "the disk quota is used up",
    errno.EROFS: "the file system is read-only",
    errno.EACCES: "no permission to write",
    errno.EPERM: "no permission to write",
    errno.EFBIG: "the file would become too large",
    errno.EIO: "the disk reports an input/output error",
    errno.ENAMETOOLONG: "the name is too long",
    errno.ENOTDIR: "a file stands where a folder is needed",
    errno.EEXIST: "a file stands where a folder is needed",
    errno.ELOOP: "its links go in a circle",
}


def disk_problem(error: BaseException) -> str | None:
    """What the disk refused, in words, or None where the error is nothing of the kind.

    HDF5 reports the system's error in its text only, so the text is read too.
    """
    if not isinstance(error, OSError):
        return None
    if error.errno in _DISK_ERRORS:
        return _DISK_ERRORS[error.errno]
    text = str(error)
    for code in (errno.ENOSPC, errno.EDQUOT, errno.EROFS):
        if os.strerror(code) in text or f"errno = {code}," in text:
            return _DISK_ERRORS[code]
    return None


@contextmanager
def output_file(path: Path) -> Iterator[Path]:
    """Write a file whole or not at all.

    Yields a temporary path beside `path`, with the same suffix; on leaving
    without an error it replaces `path`.

    Raises:
        InputError: `path` is a folder.
        OutputError: the disk refuses, or another command is writing `path`.
    """
    path = Path(os.path.abspath(path))
    if path.is_dir():
        raise InputError(f"{path}: is a folder; expected the name of a file to write")
    with _explained(path), _lock(path):
        _remove_stale(path)
        temporary = _temporary(path)
        try:
            yield temporary
            if not temporary.is_file():
                raise FileNotFoundError(errno.ENOENT, "nothing was written to the output", str(temporary))
            _sync(temporary)
            os.replace(temporary, path)
            _sync(path.parent)
        finally:
            temporary.unlink(missing_ok=True)


@contextmanager
def output_stream(path: Path) -> Iterator[BinaryIO]:
    """Write a file whole or not at all, through a stream that can be read back and sought in.

    Args:
        path: The file. The temporary that `output_file` yields is written as it is.

    Raises:
        InputError: `path` is a folder.
        OutputError: The disk refuses, or another process is writing `path`.
    """
    try:
        whole = nullcontext(path) if _TEMPORARY.search(path.name) else output_file(path)
        with whole as temporary, open(temporary, "w+b") as stream:
            yield stream
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror or error})") from error


def write_whole(path: Path, content: bytes | memoryview) -> None:
    """Write a file whole or not at all.

    Raises:
        InputError: `path` is a folder.
        OutputError: The disk refuses, or another process is writing `path`.
    """
    with output_stream(path) as stream:
        stream.write(content)


@contextmanager
def output_folder(path: Path, *, made_by: str) -> Iterator[Path]:
    """Write a folder whole or not at all.

    Yields a new temporary folder beside `path`; on leaving without an error
    it replaces `path`. A folder that holds a stranger's files is never replaced.

    Args:
        path: the folder.
        made_by: the command, noted in the folder's marker.

    Raises:
        InputError: `path` is a file, or a folder with files that are not ours.
        OutputError: the disk refuses, or another command is writing `path`.
    """
    path = Path(os.path.abspath(path))
    with _explained(path), _lock(path):
        recover_folder(path)
        _refuse_foreign(path)
        _remove_stale(path)
        temporary = _temporary(path)
        try:
            temporary.mkdir()
            yield temporary
            (temporary / MARKER).write_text(json.dumps({"made_by": made_by}) + "\n")
            _sync_tree(temporary)
            _replace_folder(temporary, path)
            _sync(path.parent)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def move_files(made: Path, folder: Path) -> None:
    """Put the files of one folder in the places of those of another, where a full disk cannot come between.

    Args:
        made: The new files, on the same disk; what is hidden stays.
        folder: Where they go. Its other files stay.
    """
    new = [path for path in sorted(made.rglob("*")) if path.is_file() and not path.name.startswith(".")]
    places = [folder / path.relative_to(made) for path in new]
    for place in places:
        place.parent.mkdir(parents=True, exist_ok=True)
    for path, place in zip(new, places, strict=True):
        os.replace(path, place)


@contextmanager
def only_writer(path: Path) -> Iterator[None]:
    """Refuse another command that would write the several files of `path` at the same time.

    Raises:
        OutputError: another command is at it.
    """
    with _lock(Path(os.path.abspath(path))):
        yield


def recover_folder(path: Path) -> None:
    """Put back a folder whose replacement died between two renames."""
    path = Path(os.path.abspath(path))  # "." has no name
    kept = path.with_name(f".{path.name}.old")
    if kept.is_dir():
        if path.exists():
            shutil.rmtree(kept)
        else:
            os.rename(kept, path)


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Turn the disk's refusals, wherever they surface, into one `OutputError` that names the output."""
    try:
        yield
    except OutputError as error:  # of a room, about our temporary: say it of the output
        problem = disk_problem(error.__cause__) if error.__cause__ is not None else None
        if problem is None:
            raise
        raise OutputError(f"{path}: cannot be written: {problem}") from error.__cause__
    except OSError as error:
        problem = disk_problem(error)
        elsewhere = isinstance(error.filename, str) and not os.path.abspath(error.filename).startswith(str(path.parent))
        if problem is None or elsewhere:
            raise
        raise OutputError(f"{path}: cannot be written: {problem}") from error


@contextmanager
def _lock(path: Path) -> Iterator[None]:
    """Hold the lock beside `path`; create its parent folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with held(path.with_name(f".{path.name}.lock")):
            yield
    except LockHeld as error:
        raise OutputError(f"{path}: is being written by another tossid command ({error.holder})") from None


def _temporary(path: Path) -> Path:
    return path.with_name(f".{path.stem}.tmp-{os.getpid()}-{secrets.token_hex(4)}{path.suffix}")


def _remove_stale(path: Path) -> None:
    """Remove temporaries of dead commands. The caller holds the lock, so none is alive."""
    own = re.compile(re.escape(f".{path.stem}.tmp-") + r"\d+-[0-9a-f]{8}" + re.escape(path.suffix))
    for entry in path.parent.iterdir():
        if own.fullmatch(entry.name) is None:
            continue
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry, ignore_errors=True)
        else:
            entry.unlink(missing_ok=True)


def _refuse_foreign(path: Path) -> None:
    if path.is_symlink() or (path.exists() and not path.is_dir()):
        raise InputError(f"{path}: exists and is no folder; choose another output folder")
    if path.is_dir() and not (path / MARKER).is_file() and any(path.iterdir()):
        raise InputError(f"{path}: holds files that tossid did not write; choose another output folder")


def _replace_folder(new: Path, path: Path) -> None:
    """Put a folder in another one's place. Where a process dies between the renames, `recover_folder` puts it back."""
    kept = path.with_name(f".{path.name}.old")
    if path.exists():
        os.rename(path, kept)
    os.rename(new, path)
    shutil.rmtree(kept, ignore_errors=True)


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EBADF):  # file systems without fsync of folders
            raise
    finally:
        os.close(handle)


def _sync_tree(folder: Path) -> None:
    """Flush a folder with all its files by one call: one for each of three thousand frames took 16 s."""
    syncfs = getattr(ctypes.CDLL(None, use_errno=True), "syncfs", None)  # (Linux)
    if syncfs is None:
        os.sync()
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        if syncfs(handle) != 0:
            code = ctypes.get_errno()
            raise OSError(code, os.strerror(code), str(folder))
    finally:
        os.close(handle)
