"""The complete part of a bag that breaks off, or has lost its index: of ROS 1, and of ROS 2 as MCAP."""

from __future__ import annotations

import heapq
import struct
from collections.abc import Collection, Generator, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from io import SEEK_END, BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from rosbags.interfaces import Connection
from rosbags.rosbag2 import reader as rosbag2
from rosbags.rosbag2.storage_mcap import ChunkInfo, McapReader, Schema, decompress
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from tossid.vision.recordings.rosbag_budget import TooLarge, check_definitions, unpack_bz2, unpack_lz4, unpack_zstd


def whole_words(count: int, last_ns: int) -> str:
    """How much of a bag that breaks off is whole."""
    return f"{count} messages are whole" + (f", the last of {last_ns * 1e-9:.3f} s" if count else "")


class Rescue:
    """A ROS 1 bag without its index, read from its start as far as its records are whole.

    Format: wiki.ros.org/Bags/Format/2.0.
    """

    def __init__(self, path: Path) -> None:
        """Read a bag's records once, to see how many are whole."""
        self.path = path
        self.connections: dict[int, tuple[str, str, str]] = {}  # topic, type, definition
        count, last = 0, 0
        for _, t_ns, _ in self._records():
            count, last = count + 1, max(last, t_ns)
        self.found = whole_words(count, last)

    def types(self) -> dict[str, str]:
        """The message type of each topic."""
        return {topic: kind for topic, kind, _ in self.connections.values()}

    def messages(self, topics: Sequence[str]) -> Iterator[tuple[str, int, Any]]:
        """(topic, time of recording [ns], message) of some topics, in the order of the file."""
        stores: dict[int, Typestore] = {}
        for number, t_ns, raw in self._records():
            topic, kind, definition = self.connections[number]
            if topic not in topics:
                continue
            if number not in stores:
                stores[number] = get_typestore(Stores.EMPTY)
                stores[number].register(get_types_from_msg(definition, kind))
                check_definitions(stores[number].fielddefs)
            yield topic, t_ns, stores[number].deserialize_ros1(raw, kind)

    def _records(self) -> Iterator[tuple[int, int, bytes]]:
        """(connection, time [ns], message) in the order of the file."""
        with self.path.open("rb") as stream:
            if not stream.readline().startswith(b"#ROSBAG V2.0"):
                return
            yield from self._walk(stream, inside=False)

    def _walk(self, stream: BinaryIO, *, inside: bool) -> Iterator[tuple[int, int, bytes]]:
        here = stream.tell()
        end = stream.seek(0, SEEK_END)
        stream.seek(here)
        while True:
            head, data, whole = _record(stream, end)
            if head is None:
                return
            op = int.from_bytes(head.get("op", b""))
            if inside and op not in (
                2,
                7,
            ):  # a chunk holds messages and connections; zeros would be millions of records
                return
            if op == 5 and not inside:
                try:
                    chunk = _unchunked(head.get("compression", b"none"), data)
                except TooLarge:
                    raise
                except (OSError, EOFError, RuntimeError, ValueError):
                    return
                yield from self._walk(BytesIO(chunk), inside=True)
            elif op == 7 and whole:
                fields = _fields(data)
                kind = fields["type"].decode().replace("/", "/msg/")
                topic = head["topic"].decode().lstrip("/")
                number = struct.unpack("<I", head["conn"])[0]
                self.connections[number] = (topic, kind, fields["message_definition"].decode())
            elif op == 2 and whole:
                number = struct.unpack("<I", head["conn"])[0]
                seconds, nanoseconds = struct.unpack("<II", head["time"])
                if number in self.connections:
                    yield number, seconds * 10**9 + nanoseconds, data
            if not whole:
                return


def _record(stream: BinaryIO, end: int) -> tuple[dict[str, bytes] | None, bytes, bool]:
    """Header fields, data, and whether it is all there; None at the end."""
    length = stream.read(4)
    if len(length) < 4:
        return None, b"", False
    header, whole = _sized(stream, length, end)
    size = stream.read(4)
    if not whole or len(size) < 4:
        return None, b"", False
    data, whole = _sized(stream, size, end)
    return _fields(header), data, whole


def _sized(stream: BinaryIO, size: bytes, end: int) -> tuple[bytes, bool]:
    """As many bytes as announced, and whether there are as many; no more is asked for than is left."""
    n, left = struct.unpack("<I", size)[0], end - stream.tell()
    return stream.read(min(n, left)), n <= left


def _fields(header: bytes) -> dict[str, bytes]:
    fields, at = {}, 0
    while at + 4 <= len(header):
        n = struct.unpack_from("<I", header, at)[0]
        name, _, value = header[at + 4 : at + 4 + n].partition(b"=")
        fields[name.decode(errors="replace")] = value
        at += 4 + n
    return fields


def _unchunked(compression: bytes, data: bytes) -> bytes:
    if compression == b"none":
        return data
    return unpack_bz2(data) if compression == b"bz2" else unpack_lz4(data)


@dataclass(frozen=True, eq=False)
class _Survey:
    """What is whole in an MCAP without its end.

    Attributes:
        end: Where the whole records end [bytes].
        connections: Of all topics.
        schemas: Message definitions by number.
        chunks: Chunks that are whole.
        tail: Messages of a chunk that is cut: connection, time [ns], content.
        count: Messages in all.
        first: Time of the first message [ns].
        last: Time of the last [ns].
    """

    end: int
    connections: tuple[Connection, ...]
    schemas: dict[int, Schema]
    chunks: tuple[ChunkInfo, ...]
    tail: tuple[tuple[int, int, bytes], ...]
    count: int
    first: int
    last: int


class RescuedMcap(McapReader):
    """An MCAP, read as far as it goes where its recorder was killed before it wrote the index.

    Format: mcap.dev/spec. Records follow each other; messages lie in chunks, of which the last may be cut.

    Attributes:
        found: How much of it is whole; None where all is.
    """

    found: str | None = None
    _tail: tuple[tuple[int, int, bytes], ...] = ()

    def _open(self) -> None:
        """Read the index, or else the whole records."""
        try:
            super()._open()
        except TooLarge:
            raise
        except Exception:
            if not self.data_start:  # not even its header is there
                raise
            about = Path(str(self.path)).stat()
            survey = _survey(str(self.path), self.data_start, about.st_size, about.st_mtime_ns)
            if not survey.connections:
                raise
            self.data_end, self.chunks, self._tail = survey.end, list(survey.chunks), survey.tail
            self.schemas = dict(survey.schemas)
            self.connections = [connection._replace(owner=self) for connection in survey.connections]
            self.metadata = self.metadata._replace(
                start_time=survey.first,
                end_time=survey.last + 1,
                duration=survey.last + 1 - survey.first,
                message_count=survey.count,
            )
            self.found = whole_words(survey.count, survey.last)

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """The messages of some connections in order of time, from `start` to before `stop` [ns]."""
        wanted = {connection.id: connection for connection in connections}
        tail = (
            (wanted[number], t_ns, data)
            for number, t_ns, data in self._tail
            if number in wanted and (start is None or t_ns >= start) and (stop is None or t_ns < stop)
        )
        yield from heapq.merge(super().messages(connections, start, stop), tail, key=lambda message: message[1])


for _reader, _key in ((rosbag2.DirectoryReader, "mcap"), (rosbag2.Reader, ".mcap")):
    _reader.STORAGE_PLUGINS[_key] = RescuedMcap  # type: ignore[index]


@lru_cache(maxsize=2)
def _survey(path: str, start: int, size: int, changed_ns: int) -> _Survey:
    """Walk through an MCAP's records; kept, since a bag is opened for each batch of its images."""
    del changed_ns  # part of the key
    scan = McapReader(Path(path))
    chunks: list[ChunkInfo] = []
    tail: tuple[tuple[int, int, bytes], ...] = ()
    counts, at = [], start
    with open(path, "rb") as file:
        while at + 9 <= size:
            file.seek(at)
            op, length = struct.unpack("<BQ", file.read(9))
            whole = at + 9 + length <= size
            if op == _CHUNK:
                chunk, content = _chunk(file.read(min(length, size - at - 9)), at, length, whole=whole)
                counts.append(_scanned(scan, BytesIO(content), 0, _whole_records(content)))
                if chunk is None:
                    messages = scan.messages_scan(scan.connections)
                    tail = tuple(sorted(((c.id, t, data) for c, t, data in messages), key=lambda message: message[1]))
                    break
                chunks.append(chunk._replace(channel_count=counts[-1].channel_message_counts))
            if not whole or not 0 < op <= _DATA_END:
                break
            at += 9 + length
        if not chunks and not tail:  # messages may lie outside of chunks
            counts.append(_scanned(scan, file, start, at))
    filled = [count for count in counts if count.message_count]
    return _Survey(
        at,
        tuple(scan.connections),
        dict(scan.schemas),
        tuple(chunks),
        tail,
        sum(count.message_count for count in filled),
        min((count.start_time for count in filled), default=0),
        max((count.end_time for count in filled), default=0),
    )


_CHUNK, _DATA_END = 0x06, 0x0F
"""Kinds of records."""


def _scanned(scan: McapReader, records: BinaryIO, start: int, end: int) -> Any:
    """Count the messages of records, and take in their topics."""
    scan.bio, scan.data_start, scan.data_end = records, start, end
    scan.meta_scan()
    return scan.statistics


def _chunk(record: bytes, at: int, length: int, *, whole: bool) -> tuple[ChunkInfo | None, bytes]:
    """A chunk and its content; None, and as much of the content as can be unpacked, where it is cut or damaged."""
    if len(record) < 32:
        return None, b""
    first, last, unpacked, crc, n_name = struct.unpack_from("<QQQII", record)
    compression = record[32 : 32 + n_name].decode(errors="replace")
    packed = record[40 + n_name :]
    if whole:
        try:
            content = decompress(packed, compression, unpacked, crc)
            return ChunkInfo(first, last, at, 9 + length, {}, 0, compression, len(packed), unpacked, {}), content
        except TooLarge:
            raise
        except Exception:  # each decompressor has errors of its own
            return None, b""
    if compression not in _UNPACK:
        return None, b""
    try:
        return None, _UNPACK[compression](packed)
    except TooLarge:
        raise
    except Exception:  # as above
        return None, b""


_UNPACK = {"": lambda data: data, "lz4": unpack_lz4, "zstd": unpack_zstd}


def _whole_records(content: bytes) -> int:
    """Where the last whole record of a chunk ends [bytes]."""
    at = 0
    while at + 9 <= len(content):
        op, length = struct.unpack_from("<BQ", content, at)
        if not op or at + 9 + length > len(content):
            break
        at += 9 + length
    return at
