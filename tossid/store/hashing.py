"""Hashes of files and folders, for the lineage of a dataset."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterator
from pathlib import Path

from tossid.errors import FileError

_BLOCK = 1 << 20


def file_sha256(path: Path | str) -> str:
    """SHA-256 of a file's bytes, in hex.

    Raises:
        FileError: the file is missing or cannot be read.
    """
    digest = hashlib.sha256()
    try:
        with open(path, "rb") as stream:
            while block := stream.read(_BLOCK):
                digest.update(block)
    except OSError as error:
        raise FileError(path, f"cannot be read ({error.strerror or error})") from error
    return digest.hexdigest()


def source_sha256(path: Path | str) -> str:
    """SHA-256 of a source: of the file, or of a folder's relative names and file hashes, in sorted order.

    Moving or touching a folder leaves its hash; changing, adding, removing or
    renaming a file in it changes the hash.
    """
    path = Path(path)
    if not path.exists():
        raise FileError(path, "no such file or folder")
    if not path.is_dir():
        return file_sha256(path)
    digest = hashlib.sha256()
    for name in _names(path, ""):
        digest.update(f"{file_sha256(path / name)}  {name}\n".encode())
    return digest.hexdigest()


def _names(folder: Path, prefix: str) -> Iterator[str]:
    """Files in a folder and below, by their relative names in sorted order; one folder's names at a time."""
    with os.scandir(folder) as entries:
        # with its slash, a folder sorts as the names in it do
        found = sorted(
            entry.name + "/" if folds else entry.name
            for entry in entries
            if (folds := entry.is_dir(follow_symlinks=False)) or entry.is_file()
        )
    for name in found:
        if name.endswith("/"):
            yield from _names(folder / name, prefix + name)
        else:
            yield prefix + name


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sort key that puts "2" before "10"."""
    parts = re.split(r"([0-9]+)", name)
    return tuple((0, int(part), "") if part.isdigit() else (1, 0, part) for part in parts if part)
