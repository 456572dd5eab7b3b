"""HDF5 from outside: the checks that HDF5 itself does not make, before anything is read.

A damaged or hostile file may declare shapes that fill the memory, filters and links that load other files, chunks that
inflate without end, and heaps of strings that do not end.
"""

from __future__ import annotations

import math
import mmap
import re
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tossid import budget
from tossid.errors import FileError

MAX_COMPRESSION = 1040
"""Deflate cannot shrink data by more than 1032."""
SMALL_CHUNK = 1 << 14
"""Stored bytes of a chunk up to which what it inflates to is not looked at: it is at most 16 MiB."""
HEADERS = 1 << 20
"""Bytes of HDF5's headers, as they lie in the file, that stay in memory, where they take some ten times as much. HDF5's
own limit is 32 MiB."""
_CHECKSUM = 4
"""Bytes of Fletcher's checksum."""
_FILTERS = frozenset({h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_FLETCHER32})
"""HDF5 would load a plugin (code) for others."""
_HEAP = b"GCOL\x01\0\0\0"
"""Signature, version and three reserved bytes of a heap."""
_HEAD = 16
"""Bytes of a heap's header and of an object's, where lengths take 8."""


class CheckedGroup:
    """A group of a file from outside: what is taken from it is there, in this file, and of the kind expected."""

    def __init__(self, path: Path, group: h5py.Group) -> None:
        self.path, self._group = path, group

    @property
    def name(self) -> str:
        """Its whole name in the file."""
        return str(self._group.name)

    @property
    def members(self) -> list[str]:
        """Names of its groups and arrays."""
        return list(self._group)

    @property
    def attributes(self) -> list[str]:
        """Names of its attributes, sorted."""
        return sorted(self._group.attrs)

    def refuse_others(self, known: set[str]) -> None:
        """Refuse members that are none of the known ones.

        Raises:
            FileError: There is one.
        """
        others = sorted(set(self._group) - known)
        if others:
            raise FileError(self.path, f"{self.name} holds {others[0]!r}, which the schema does not know")

    def group(self, name: str) -> CheckedGroup:
        """A group in it.

        Raises:
            FileError: There is none in this file.
        """
        return CheckedGroup(self.path, self._member(name, h5py.Group, "group"))

    def array(
        self, name: str, dtype: np.dtype[Any] | str, shape: tuple[int | None, ...], *, others: int = 0
    ) -> h5py.Dataset:
        """An array in it, of which nothing is read yet.

        Args:
            name: Its name.
            dtype: Its type.
            shape: Its shape; None where any length will do.
            others: Bytes of the arrays that are read with it, which may be links to the same one.

        Raises:
            FileError: There is none in this file, it has another type or shape, or its bytes are not in the file.
        """
        data = self._member(name, h5py.Dataset, "data set")
        if data.dtype != dtype:
            raise FileError(self.path, f"{data.name} has type {data.dtype}, expected {np.dtype(dtype)}")
        fits = len(data.shape) == len(shape) and all(n in (None, m) for n, m in zip(shape, data.shape, strict=True))
        if not fits:
            expected = ", ".join("n" if length is None else str(length) for length in shape)
            raise FileError(self.path, f"{data.name} has shape {data.shape}, expected ({expected})")
        _check_stored(self.path, data, others)
        return data

    def attribute(self, name: str, kind: type, default: Any = None) -> Any:
        """An attribute as Python's own text, whole number or number.

        Args:
            name: Its name.
            kind: str, int or float.
            default: What holds where it is missing; None refuses that.

        Raises:
            FileError: It is missing, of another type or, of numbers, not finite.
        """
        if name not in self._group.attrs:
            if default is None:
                raise FileError(self.path, f"attribute {name!r} of {self.name} is missing")
            return default
        value = self.value(name)
        if kind is float and type(value) is int:
            value = float(value)
        if type(value) is not kind:
            problem = f"is {type(value).__name__}, expected {kind.__name__}"
            raise FileError(self.path, f"attribute {name!r} of {self.name} {problem}")
        if isinstance(value, float) and not math.isfinite(value):
            raise FileError(self.path, f"attribute {name!r} of {self.name} is not finite")
        return value

    def numbers(self, name: str, shape: tuple[int, ...], *, finite: bool = True) -> np.ndarray:
        """An attribute that is an array of numbers.

        Raises:
            FileError: It is missing, no such array, or not finite though it should be.
        """
        value = np.asarray(self._group.attrs.get(name))
        if value.shape != shape or value.dtype.kind not in "if":
            problem = f"is {value!r}, expected numbers of shape {shape}"
            raise FileError(self.path, f"attribute {name!r} of {self.name} {problem}")
        if finite and not np.isfinite(value).all():
            raise FileError(self.path, f"attribute {name!r} of {self.name} is not finite")
        return value

    def value(self, name: str) -> Any:
        """An attribute of any type; NumPy's scalars as Python's own."""
        return plain(self._group.attrs[name])

    def _member(self, name: str, kind: type, word: str) -> Any:
        link = self._group.get(name, getlink=True)
        where = f"{self.name.rstrip('/')}/{name}"
        if link is None:
            raise FileError(self.path, f"{word} {where} is missing")
        if not isinstance(link, h5py.HardLink):
            raise FileError(self.path, f"{where} is a link elsewhere, expected a {word} in the file itself")
        member = self._group[name]
        if not isinstance(member, kind):
            raise FileError(self.path, f"{where} is not a {word}")
        return member


@contextmanager
def opened(path: Path) -> Iterator[CheckedGroup]:
    """A file, for reading; `explained` should be around what is read of it.

    Raises:
        FileError: It is missing, damaged, or no HDF5 file.
    """
    if not path.is_file():
        raise FileError(path, "no such dataset file")
    with explained(path):
        check_heaps(path)
        file = frugal(h5py.File(path, "r", locking="best-effort"))
    with file:
        yield CheckedGroup(path, file)


@contextmanager
def explained(path: Path) -> Iterator[None]:
    """Whatever HDF5 finds wrong with a file becomes one `FileError`."""
    try:
        yield
    except FileError:
        raise
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError, UnicodeError) as error:
        first = next(iter(str(error).strip().splitlines()), type(error).__name__)
        raise FileError(path, f"damaged, or not an HDF5 file ({first})") from error


def plain(value: Any) -> Any:
    """NumPy scalars as Python's own; everything else as it is."""
    return value.item() if isinstance(value, np.generic) else value


def frugal(file: h5py.File) -> h5py.File:
    """The file, with a cache of headers that does not grow beyond `HEADERS`."""
    config = file.id.get_mdc_config()
    config.set_initial_size = True
    config.initial_size = config.min_size = config.max_size = HEADERS
    config.incr_mode = config.flash_incr_mode = config.decr_mode = 0  # it stays as it is
    file.id.set_mdc_config(config)
    return file


def _check_stored(path: Path, data: h5py.Dataset, others: int) -> None:
    """Refuse an array whose bytes are not in the file, or are packed by what HDF5 would load code for."""
    where = data.name
    if data.is_virtual or data.external:
        raise FileError(path, f"{where} keeps its data in another file")
    properties = data.id.get_create_plist()
    filters = [properties.get_filter(k)[0] for k in range(properties.get_nfilters())]
    if not _FILTERS.issuperset(filters) or len(set(filters)) < len(filters):
        raise FileError(path, f"{where} uses filters {filters}, expected shuffle, deflate and Fletcher's, each once")
    declared = math.prod(data.shape) * data.dtype.itemsize
    stored = data.id.get_storage_size()
    if declared > stored * MAX_COMPRESSION:
        raise FileError(path, f"{where} declares {declared} bytes, more than its {stored} stored bytes can hold")
    what = f"bytes of tosses, up to {where}" if others else f"bytes of {where}"
    budget.check_unpacked(path, others + declared, what=what)
    if data.chunks is not None:
        chunk = math.prod(data.chunks) * data.dtype.itemsize
        budget.check_unpacked(path, chunk, what=f"bytes of a chunk of {where}")
        if h5py.h5z.FILTER_DEFLATE in filters:
            _check_inflated(path, data, chunk)


def _check_inflated(path: Path, data: h5py.Dataset, chunk: int) -> None:
    """Refuse an array with a chunk that inflates to more than its size: HDF5 makes room for all that comes."""
    large: list[tuple[int, ...]] = []
    # (the visitor returns None: HDF5 goes on)
    data.id.chunk_iter(lambda info: large.append(info.chunk_offset) if info.size > SMALL_CHUNK else None)
    for offset in large:
        mask, content = data.id.read_direct_chunk(offset)
        if mask:
            raise FileError(path, f"{data.name} has a chunk with filters of its own, which the schema does not know")
        try:
            inflated = len(zlib.decompressobj().decompress(content, chunk + _CHECKSUM + 1))
        except zlib.error as error:
            raise FileError(path, f"damaged: {data.name} cannot be inflated ({error})") from error
        if inflated > chunk + _CHECKSUM:
            raise FileError(path, f"{data.name} has a chunk that inflates to more than its {chunk} bytes")


def check_heaps(path: Path) -> None:
    """Refuse a file with a heap whose objects do not follow one another to its end, or with heaps that overlap.

    Strings of attributes lie in heaps of objects one after the other. HDF5 (2.0.0) steps from one object to the next by
    the size that is written there, and does not end where that size is none. Format: HDF5 File Format Specification
    3.0, III.E.

    Raises:
        FileError: There is one.
        OSError: The file cannot be read.
    """
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        end = 0
        for found in re.finditer(re.escape(_HEAP), content):
            place = found.start()
            if place < end:  # so that no byte is looked at twice
                raise FileError(path, f"damaged: the heaps of strings at bytes before {end} and at {place} overlap")
            size = int.from_bytes(content[found.end() : found.end() + 8], "little")
            if not _HEAD <= size <= len(content) - place or not _is_sound(content[place + _HEAD : place + size]):
                raise FileError(path, f"damaged: the heap of strings at byte {place} does not hold together")
            end = place + size


def _is_sound(heap: bytes) -> bool:
    """Whether objects fill a heap. What is too short for one at its end is free, and so is an object of index 0."""
    at = 0
    while at + _HEAD <= len(heap):
        index, length = struct.unpack_from("<H6xQ", heap, at)
        step = _HEAD + (length + 7) // 8 * 8 if index else length
        if not _HEAD <= step <= len(heap) - at:
            return False
        at += step
    return True
