"""Hashes of files and folders, for the lineage of a dataset."""

from __future__ import annotations

import hashlib
import os
import re
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

    Moving or touching a folder leaves its hash; changing, adding, removing or renaming a file in it changes the hash.

    Raises:
        FileError: There is no such file or folder, or a file cannot be read.
    """
    path = Path(path)
    if not path.exists():
        raise FileError(path, "no such file or folder")
    if not path.is_dir():
        return file_sha256(path)
    found = [Path(folder, name) for folder, _, names in os.walk(path, onerror=_refuse) for name in names]
    digest = hashlib.sha256()
    for name in sorted(file.relative_to(path).as_posix() for file in found if file.is_file()):
        digest.update(f"{file_sha256(path / name)}  {name}\n".encode())
    return digest.hexdigest()


def _refuse(error: OSError) -> None:
    raise FileError(error.filename, f"cannot be read ({error.strerror})") from error


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sort key that puts "2" before "10"."""
    parts = re.split(r"([0-9]+)", name)
    return tuple((0, int(part), "") if part.isdigit() else (1, 0, part) for part in parts if part)
