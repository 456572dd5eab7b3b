"""The complete part of a ROS 1 bag that breaks off, or has lost its index."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from io import SEEK_END, BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from tossid.vision.recordings.rosbag_budget import TooLarge, check_definitions, unpack_bz2, unpack_lz4


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
        self.found = f"{count} messages are whole, the last of {last * 1e-9:.3f} s"

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
