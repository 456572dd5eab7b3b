"""What a bag may cost: its parts, chunks and message definitions, held to the budget of `tossid.budget`.

The library `rosbags` unpacks chunks without a limit, reads what a database computes, and has no setting for either. So
its tables of decompressors and of readers are given ones that refuse.
"""

from __future__ import annotations

import bz2
import re
import sqlite3
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO, Protocol
from urllib.parse import quote

import lz4.frame
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import reader as rosbag1
from rosbags.rosbag2 import reader as rosbag2
from rosbags.rosbag2 import storage_mcap

from tossid import budget
from tossid.errors import FileError, ObjectError, brief
from tossid.objects.references import inside
from tossid.yaml_files import read_yaml

_ZSTD: Any = rosbag2.zstd
ZstdError: type[Exception] = _ZSTD.ZstdError
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""First bytes of what Zstandard packed."""
_AT_ONCE = 1 << 20
"""Bytes."""
_COMPUTED = re.compile(r"\b(AS|VIRTUAL)\b", re.IGNORECASE)
"""Words in the definition of a table, index or column whose content is computed."""
_NESTED = 50
"""Messages inside one another."""


_excess = 0
"""Bytes by which chunks have exceeded `ReadLimits.ratio` since `forget_excess`; at most `ReadLimits.unpacked`."""


class TooLarge(Exception):
    """Packed content, or a message's definition, that claims more than the budget."""


class _Decompressor(Protocol):
    def decompress(self, data: bytes, max_length: int) -> bytes:
        """At most so many bytes of the content."""
        ...


def _unpack(make: Callable[[], _Decompressor], data: bytes) -> bytes:
    """A chunk's content.

    Raises:
        TooLarge: It is larger than the budget allows.
    """
    global _excess
    limit = budget.unpacked_allowance(len(data), least=budget.limits().chunk)
    content = make().decompress(data, max_length=limit + 1)
    if len(content) > limit:
        raise TooLarge(f"a chunk of {len(data)} bytes claims more than {limit} bytes when unpacked")
    ratio = budget.limits().ratio
    _excess += max(0, len(content) - ratio * len(data))
    if _excess > budget.limits().unpacked:
        raise TooLarge(f"its chunks claim {_excess} bytes beyond {ratio} times their size when unpacked")
    return bytes(content)


def forget_excess() -> None:
    """Begin to count anew what chunks claim: another bag is opened."""
    global _excess
    _excess = 0


def unpack_bz2(data: bytes) -> bytes:
    """The content of a chunk that bzip2 packed; `TooLarge` beyond the budget."""
    return _unpack(bz2.BZ2Decompressor, data)


def unpack_lz4(data: bytes) -> bytes:
    """The content of a chunk that LZ4 packed; `TooLarge` beyond the budget."""
    return _unpack(lz4.frame.LZ4FrameDecompressor, data)


def unpack_zstd(data: bytes) -> bytes:
    """The content of a chunk or message that Zstandard packed; `TooLarge` beyond the budget."""
    return _unpack(_ZSTD.ZstdDecompressor, data)


def open_zstd(path: Path) -> Any:
    """A stream of the content of a file that Zstandard packed."""
    return _ZSTD.open(path, "rb")


def copy_within(packed: Any, out: BinaryIO, limit: int) -> None:
    """Copy a stream that is unpacked on the way.

    Args:
        packed: What is read.
        out: Where it goes.
        limit: Most bytes.

    Raises:
        TooLarge: There are more.
    """
    copied = 0
    while some := packed.read(_AT_ONCE):
        copied += len(some)
        if copied > limit:
            raise TooLarge(f"claims more than {limit:,} bytes when unpacked")
        out.write(some)


class _Limited:
    """A file that Zstandard packed, read up to the budget."""

    def __init__(self, file: BinaryIO, mode: str = "rb") -> None:
        size = file.seek(0, 2)
        file.seek(0)
        self._inner, self._left = _ZSTD.open(file, mode), budget.unpacked_allowance(size)

    def __enter__(self) -> _Limited:
        return self

    def __exit__(self, *_: object) -> None:
        self._inner.close()

    def read(self, size: int = -1) -> bytes:
        """The next bytes; `TooLarge` beyond the budget."""
        content: bytes = self._inner.read(size)
        self._left -= len(content)
        if self._left < 0:
            raise TooLarge("claims more bytes when unpacked than its size allows")
        return content


class _StoredDatabase(rosbag2.Sqlite3Reader):
    """A part in SQLite's format, opened where it stores what it holds: computed content can be without end."""

    def open(self) -> None:
        """Open it; `TooLarge` where it computes something, and an error of SQLite's where it is no database."""
        with closing(sqlite3.connect(f"file:{quote(str(self.path))}?immutable=1", uri=True)) as database:
            for kind, name, definition in database.execute("SELECT type, name, sql FROM sqlite_master"):
                if kind not in ("table", "index") or _COMPUTED.search(definition or ""):
                    raise TooLarge(f"its {kind} {brief(name)} is computed, expected a table that is stored")
        super().open()


for _reader, _key in ((rosbag2.DirectoryReader, "sqlite3"), (rosbag2.Reader, ".db3")):
    _reader.STORAGE_PLUGINS[_key] = _StoredDatabase  # type: ignore[index]
rosbag1.decompressors.update({"bz2": unpack_bz2, "lz4": unpack_lz4})
storage_mcap.DECOMPRESSORS.update({"lz4": lambda data, _: unpack_lz4(data), "zstd": lambda data, _: unpack_zstd(data)})
setattr(rosbag2, "zstd", SimpleNamespace(open=_Limited, decompress=unpack_zstd))  # noqa: B010 (mypy knows no such name)


def check_parts(path: Path) -> None:
    """Refuse a ROS 2 bag that names files outside its folder; of other bags, what is no regular file.

    Args:
        path: The bag.

    Raises:
        FileError: It is one.
    """
    if not path.is_dir():
        budget.regular_size(path)
        return
    about = read_yaml(path / "metadata.yaml").get("rosbag2_bagfile_information")
    names = about.get("relative_file_paths") if isinstance(about, dict) else None
    for name in names if isinstance(names, list) else []:
        try:
            inside(path, str(name))
        except ObjectError as error:
            raise FileError(path / "metadata.yaml", f"relative_file_paths: {error}") from error


def missing_metadata(folder: Path, parts: Sequence[str]) -> str | None:
    """What a ROS 2 bag's metadata.yaml lacks, None where it names topics and all of the folder's files.

    Args:
        folder: The bag.
        parts: Names of its files of messages.
    """
    file = folder / "metadata.yaml"
    if not file.is_file():
        return "has no metadata.yaml"
    try:
        about = read_yaml(file).get("rosbag2_bagfile_information")
    except FileError:
        about = None
    if not isinstance(about, dict) or not about.get("topics_with_message_count"):
        return "has a metadata.yaml that names no topics"
    names = about.get("relative_file_paths")
    named = {Path(str(name)).name for name in names} if isinstance(names, list) else set()
    strange = [part for part in parts if part not in named and f"{part}.zstd" not in named]
    return f"has a metadata.yaml that does not name {strange[0]}" if strange else None


def check_definitions(types: Mapping[str, Any]) -> None:
    """Refuse messages whose definition alone asks for too much, before code is made from it.

    Args:
        types: Fields of each type, as `rosbags` holds them.

    Raises:
        TooLarge: A message holds too many items that are not plain numbers, or a list of items that take no bytes, of
            which a few bytes can announce billions.
    """
    for name in types:
        items, _ = _cost(types, (Nodetype.NAME, name), 0)
        limit = budget.limits().message_items
        if items > limit:
            raise TooLarge(f"a message of type {brief(name)} claims {items:,} items, expected at most {limit:,}")


def _cost(types: Mapping[str, Any], node: tuple[Any, Any], depth: int) -> tuple[int, int]:
    """Items that a field makes for itself, and least bytes that it takes."""
    kind, about = node
    if depth > _NESTED:
        raise TooLarge(f"a message holds others more than {_NESTED} deep")
    if kind == Nodetype.BASE:
        return (1, 4) if about[0] in ("string", "wstring") else (0, 1)
    if kind == Nodetype.NAME:
        if about not in types:
            return 0, 1
        fields = [_cost(types, field, depth + 1) for _, field in types[about][1]]
        return 1 + sum(items for items, _ in fields), sum(least for _, least in fields)
    inner, count = about
    items, least = _cost(types, inner, depth + 1)
    if not least:
        raise TooLarge("a message claims a list of messages that hold nothing")
    return (count * items, count * least) if kind == Nodetype.ARRAY else (items, 4)
