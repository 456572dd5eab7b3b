"""HDF5's global heaps, checked before HDF5 reads them.

Strings of attributes lie in heaps, "GCOL" blocks of objects one after the other. HDF5 (2.0.0) steps from one object to
the next by the size that is written there, and does not end where that size is none. Format: HDF5 File Format
Specification 3.0, III.E.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO

from tossid.errors import FileError

_BEGIN = b"GCOL\x01\0\0\0"
"""Signature, version and three reserved bytes."""
_HEADER = 16
"""Bytes of a heap's header and of an object's, where lengths take 8."""
_PART = 2**20


def check_heaps(path: Path) -> None:
    """Refuse a file with a heap whose objects do not follow one another to its end, or with heaps that overlap.

    Raises:
        FileError: there is one.
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        end, free = path.stat().st_size, 0
        for place in _places(file):
            if place < free:  # so that no byte is looked at twice
                raise FileError(path, f"damaged: the heaps of strings at bytes before {free} and at {place} overlap")
            file.seek(place + len(_BEGIN))
            size = int.from_bytes(file.read(8), "little")
            if not _HEADER <= size <= end - place or not _is_sound(file.read(size - _HEADER)):
                raise FileError(path, f"damaged: the heap of strings at byte {place} does not hold together")
            free = place + size


def _places(file: BinaryIO) -> list[int]:
    """Where heaps begin, in bytes."""
    out, before, at = [], b"", 0
    while part := file.read(_PART):
        part = before + part
        found = part.find(_BEGIN)
        while found >= 0:
            out.append(at + found)
            found = part.find(_BEGIN, found + 1)
        before = part[1 - len(_BEGIN) :]
        at += len(part) - len(before)
    return out


def _is_sound(content: bytes) -> bool:
    """Whether objects fill a heap. What is too short for one at its end is free, and so is an object of index 0."""
    at = 0
    while at + _HEADER <= len(content):
        index, length = struct.unpack_from("<H6xQ", content, at)
        step = _HEADER + (length + 7) // 8 * 8 if index else length
        if not _HEADER <= step <= len(content) - at:
            return False
        at += step
    return True
