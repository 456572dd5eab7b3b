"""The records of ROS bags, read from the front: of ROS 1 (`.bag`), and of ROS 2 as MCAP or SQLite (`.db3`).

Nothing rests on the index at a file's end. So a bag whose recorder was killed is read as far as its records are whole,
by the same code as any other. Formats: wiki.ros.org/Bags/Format/2.0 and mcap.dev/spec. What a file claims is held to
the budget of `tossid.budget` before room is made for it.
"""

from __future__ import annotations

import bz2
import re
import sqlite3
import struct
import sys
from binascii import crc32
from collections.abc import Callable, Collection, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, Protocol
from urllib.parse import quote

import lz4.frame

from tossid import budget
from tossid.errors import FileError, brief

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""First bytes of what Zstandard packed."""
MCAP_MAGIC = b"\x89MCAP0\r\n"
_COMPUTED = re.compile(r"\b(AS|VIRTUAL)\b", re.IGNORECASE)
"""Words in the definition of a table, index or column whose content is computed, and may be without end."""
_UNPACKERS: dict[str, Callable[[], Any]] = {
    "bz2": bz2.BZ2Decompressor,
    "lz4": lz4.frame.LZ4FrameDecompressor,
    "zstd": zstd.ZstdDecompressor,
}
_PLAIN = ("", "none")
_DAMAGE = (OSError, EOFError, RuntimeError, ValueError, zstd.ZstdError)
"""What the decompressors raise where their input is damaged."""


class Topic(NamedTuple):
    """What a connection or channel of a bag carries."""

    name: str
    """without a leading "/" """
    kind: str
    """message type, as ROS 2 writes it: package/msg/Name"""
    definition: str
    """of the type and all that it holds; empty where the bag has none"""
    encoding: str
    """"ros1" or "cdr", how messages are serialised"""


class Message(NamedTuple):
    """A message as it was recorded."""

    topic: int
    """number of its topic"""
    t_ns: int
    """time of recording [ns]"""
    data: bytes
    """its serialised content"""


class Chunk(NamedTuple):
    """A stretch of a file with records of its own."""

    at: int
    """where its content begins [bytes]"""
    size: int
    """of the content as it is stored, as far as it is there [bytes]"""
    compression: str
    """one of `_UNPACKERS`, or `_PLAIN`"""
    unpacked: int | None = None
    """size of the unpacked content as it is stated [bytes]"""
    crc: int = 0
    """its checksum, 0 for none"""
    first_ns: int = 0
    """time of its first message [ns]"""
    last_ns: int = -1
    """time of its last message [ns]"""


class Storage(Protocol):
    """A file of messages."""

    topics: dict[int, Topic]
    """by number"""
    count: int
    """whole messages"""
    last_ns: int
    """time of the last of them [ns]"""
    is_cut: bool
    """whether the file breaks off before its end"""

    def messages(self, topics: Collection[int], start: int, stop: int) -> Iterator[Message]:
        """The messages of some topics from `start` to before `stop` [ns], in order of time."""
        ...


def open_storage(path: Path) -> Storage:
    """The messages of one file of a bag.

    Args:
        path: A `.bag`, `.mcap` or `.db3`.

    Raises:
        FileError: It is none, nothing of it is whole, or it claims too much.
    """
    if path.suffix == ".db3":
        return _Database(path)
    about = path.stat()
    records = _Ros1 if path.suffix == ".bag" else _Mcap
    return _Chunked(path, records, _survey(path, records, about.st_size, about.st_mtime_ns))


def unpack(path: Path, compression: str, data: bytes) -> bytes:
    """What a chunk or message unpacks to; of one that is cut, as much as there is.

    Args:
        path: The file, for the error.
        compression: "", "none", "bz2", "lz4" or "zstd".
        data: As stored.

    Raises:
        FileError: It unpacks to more than the budget allows.
        Exception: One of `_DAMAGE`.
    """
    if compression in _PLAIN:
        return data
    limit = budget.unpacked_allowance(len(data), least=budget.limits().chunk)
    content = bytes(_UNPACKERS[compression]().decompress(data, max_length=limit + 1))
    if len(content) > limit:
        raise FileError(path, f"a chunk of {len(data)} bytes claims more than {limit} bytes when unpacked")
    return content


class _Records(Protocol):
    """The records of a format, in a file or in a chunk's content."""

    magic: bytes
    """with which a file begins"""
    ended: bool
    """whether the record that ends a file was met"""

    def walk(self, stream: BinaryIO, end: int) -> Iterator[Chunk | Message | tuple[int, Topic]]:
        """Chunks, messages and topics, up to the first record that is not whole."""
        ...


class _Ros1:
    """Records with a header of named fields."""

    magic = b"#ROSBAG V2.0\n"

    def __init__(self) -> None:
        self.ended = False

    def walk(self, stream: BinaryIO, end: int) -> Iterator[Chunk | Message | tuple[int, Topic]]:
        is_indexed = False
        while stream.tell() + 8 <= end:
            head = stream.read(min(_uint32(stream.read(4)), end - stream.tell()))
            length = stream.read(4)
            if len(length) < 4:
                return
            fields, size, at = _fields(head), _uint32(length), stream.tell()
            kind, is_whole = int.from_bytes(fields.get("op", b"")[:1]), at + size <= end
            if kind == 5:
                compression = fields.get("compression", b"none").decode(errors="replace")
                yield Chunk(at, min(size, end - at), compression, _uint32(fields.get("size", bytes(4))))
            if not is_whole or not 2 <= kind <= 7:
                return
            if kind == 3:
                is_indexed = any(fields.get("index_pos", b""))
            elif kind == 7:
                about, topic = _fields(stream.read(size)), fields["topic"].decode().lstrip("/")
                name = about["type"].decode().replace("/", "/msg/")
                definition = about["message_definition"].decode()
                yield _uint32(fields["conn"]), Topic(topic, name, definition, "ros1")
            elif kind == 2:
                seconds, nanoseconds = struct.unpack("<II", fields["time"])
                yield Message(_uint32(fields["conn"]), seconds * 10**9 + nanoseconds, stream.read(size))
            stream.seek(at + size)
        self.ended = is_indexed and stream.tell() == end


class _Mcap:
    """Records of a kind and a length."""

    magic = MCAP_MAGIC

    def __init__(self) -> None:
        self.ended = False
        self._schemas: dict[int, tuple[str, str]] = {}

    def walk(self, stream: BinaryIO, end: int) -> Iterator[Chunk | Message | tuple[int, Topic]]:
        while stream.tell() + 9 <= end:
            kind, size = struct.unpack("<BQ", stream.read(9))
            at = stream.tell()
            if kind == 6 and at + 40 <= end:
                _, _, unpacked, crc, n = struct.unpack("<QQQII", stream.read(32))
                compression, inner = stream.read(min(n, end - at - 32)).decode(errors="replace"), at + 40 + n
                yield Chunk(inner, max(0, min(at + size, end) - inner), compression, unpacked, crc)
            if at + size > end or not kind:
                return
            record = BytesIO(stream.read(size) if kind in (3, 4, 5) else b"")
            if kind == 2:
                self.ended = stream.seek(at + size) + len(MCAP_MAGIC) == end and stream.read(8) == MCAP_MAGIC
            elif kind == 3:
                number, name, encoding, text = _uint16(record), *(_string(record) for _ in range(3))
                self._schemas[number] = name, text if encoding in ("ros2msg", "ros1msg") else ""
            elif kind == 4:
                number, schema = _uint16(record), self._schemas.get(_uint16(record), ("", ""))
                topic, encoding = _string(record).lstrip("/"), _string(record)
                yield number, Topic(topic, *schema, encoding)
            elif kind == 5:
                topic_number, _, t_ns, _ = struct.unpack("<HIQQ", record.read(22))
                yield Message(topic_number, t_ns, record.read())
            stream.seek(at + size)


@dataclass
class _Survey:
    """What is whole in a file."""

    topics: dict[int, Topic] = field(default_factory=dict)
    chunks: list[Chunk] = field(default_factory=list)
    count: int = 0
    last_ns: int = 0
    is_cut: bool = True


@lru_cache(maxsize=4)
def _survey(path: Path, make: Callable[[], _Records], size: int, changed_ns: int) -> _Survey:
    """Walk through a file once; kept, since a bag is opened anew for each batch of its images."""
    del changed_ns  # part of the key
    found, records, excess = _Survey(), make(), 0
    with path.open("rb") as stream:
        if stream.read(len(records.magic)) != records.magic:
            raise FileError(path, "is not a bag that can be read: it does not begin as one")
        try:
            for record in records.walk(stream, size):
                if isinstance(record, Message):  # outside of chunks
                    record = Chunk(stream.tell() - len(record.data) - 31, len(record.data) + 31, "")
                if not isinstance(record, Chunk):
                    found.topics[record[0]] = record[1]
                    continue
                here = stream.tell()
                content, is_whole = _content(path, stream, record)
                stream.seek(here)
                excess += max(0, len(content) - budget.limits().ratio * record.size)
                if excess > budget.limits().unpacked:
                    ratio = budget.limits().ratio
                    raise FileError(path, f"its chunks claim {excess} bytes beyond {ratio} times their size")
                _count(found, record, records, content)
                if not is_whole:
                    break
        except (struct.error, KeyError, UnicodeDecodeError, OverflowError):
            pass  # a damaged record ends what is whole
    found.is_cut = not records.ended
    if not found.topics and found.is_cut:
        raise FileError(path, "is not a bag that can be read: it breaks off before its first topic")
    return found


def _content(path: Path, stream: BinaryIO, chunk: Chunk) -> tuple[bytes, bool]:
    """A chunk's content, and whether it is what the chunk states; nothing of one that is damaged."""
    stream.seek(chunk.at)
    try:
        content = unpack(path, chunk.compression, stream.read(chunk.size))
    except (KeyError, *_DAMAGE):
        return b"", False
    is_whole = chunk.unpacked in (None, len(content)) and (not chunk.crc or crc32(content) == chunk.crc)
    return b"" if len(content) == chunk.unpacked and not is_whole else content, is_whole


def _count(found: _Survey, chunk: Chunk, records: _Records, content: bytes) -> None:
    """Take a chunk with its topics and messages into a survey."""
    times = []
    for record in records.walk(BytesIO(content), len(content)):
        if isinstance(record, Message):
            times.append(record.t_ns)
        elif not isinstance(record, Chunk):
            found.topics[record[0]] = record[1]
    if times:
        last = found.chunks[-1] if found.chunks else chunk
        if chunk.unpacked is None and last.unpacked is None and last.at + last.size == chunk.at:
            # messages outside of chunks, one after another
            found.chunks[-1] = last._replace(size=last.size + chunk.size, last_ns=max(last.last_ns, *times))
        else:
            found.chunks.append(chunk._replace(first_ns=min(times), last_ns=max(times)))
        found.count += len(times)
        found.last_ns = max(found.last_ns, *times)


class _Chunked:
    """A ROS 1 bag or an MCAP, whose chunks are unpacked one at a time."""

    def __init__(self, path: Path, records: Callable[[], _Records], survey: _Survey) -> None:
        self._path, self._records, self._chunks = path, records, survey.chunks
        self.topics, self.count, self.last_ns = survey.topics, survey.count, survey.last_ns
        self.is_cut = survey.is_cut

    def messages(self, topics: Collection[int], start: int, stop: int) -> Iterator[Message]:
        """As `Storage` has it; in the order of the chunks."""
        with self._path.open("rb") as stream:
            for chunk in self._chunks:
                if chunk.last_ns < start or chunk.first_ns >= stop:
                    continue
                content, _ = _content(self._path, stream, chunk)
                records = self._records().walk(BytesIO(content), len(content))
                found = [record for record in records if isinstance(record, Message)]
                chosen = (one for one in found if one.topic in topics and start <= one.t_ns < stop)
                yield from sorted(chosen, key=lambda message: message.t_ns)


class _Database:
    """A ROS 2 bag's SQLite database; it is used only where it stores what it holds."""

    is_cut = False

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            with closing(self._connected()) as database:
                for kind, name, sql in database.execute("SELECT type, name, sql FROM sqlite_master"):
                    if kind not in ("table", "index") or _COMPUTED.search(sql or ""):
                        raise FileError(path, f"its {kind} {brief(name)} is computed, expected a table that is stored")
                topics = database.execute("SELECT id, name, type FROM topics").fetchall()
                definitions = dict[str, str]()
                if database.execute("SELECT 1 FROM sqlite_master WHERE name = 'message_definitions'").fetchone():
                    columns = "topic_type, encoded_message_definition"
                    query = f"SELECT {columns} FROM message_definitions WHERE encoding = 'ros2msg'"
                    definitions = dict(database.execute(query))
                count, last = database.execute("SELECT count(*), max(timestamp) FROM messages").fetchone()
        except sqlite3.Error as error:
            raise FileError(path, f"is not a bag that can be read: {error}") from error
        self.topics = {
            int(number): Topic(str(name).lstrip("/"), str(kind), str(definitions.get(kind, "")), "cdr")
            for number, name, kind in topics
        }
        self.count, self.last_ns = int(count), int(last or 0)

    def _connected(self) -> sqlite3.Connection:
        return sqlite3.connect(f"file:{quote(str(self._path))}?immutable=1", uri=True)

    def messages(self, topics: Collection[int], start: int, stop: int) -> Iterator[Message]:
        """As `Storage` has it."""
        query = "SELECT topic_id, timestamp, data FROM messages WHERE timestamp >= ? AND timestamp < ? AND topic_id IN "
        marks = f"({', '.join('?' * len(topics))}) ORDER BY timestamp"
        with closing(self._connected()) as database:
            for number, t_ns, data in database.execute(query + marks, (start, stop, *topics)):
                yield Message(int(number), int(t_ns), bytes(data))


def _uint16(stream: BinaryIO) -> int:
    return int(struct.unpack("<H", stream.read(2))[0])


def _uint32(data: bytes) -> int:
    return int(struct.unpack("<I", data)[0])


def _string(stream: BinaryIO) -> str:
    return stream.read(_uint32(stream.read(4))).decode()


def _fields(header: bytes) -> dict[str, bytes]:
    """The named fields of a ROS 1 header."""
    fields, at = {}, 0
    while at + 4 <= len(header):
        n = _uint32(header[at : at + 4])
        name, _, value = header[at + 4 : at + 4 + n].partition(b"=")
        fields[name.decode(errors="replace")] = value
        at += 4 + n
    return fields
