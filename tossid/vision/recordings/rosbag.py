"""ROS 1 and ROS 2 bags without ROS: their files found and unpacked, and their messages (by the `rosbags` library).

A bag is a `.bag` file, plain or packed (`.bag.bz2`, `.bag.gz`), or a ROS 2 bag: its folder, or a single `.mcap`.
A bag whose recorder was killed is read as far as it is whole, and its `problems` say so: a ROS 1 bag or an MCAP that
breaks off, a ROS 2 bag without metadata.yaml, or with one that does not name all of its files.
"""

from __future__ import annotations

import bz2
import gzip
import re
import shutil
import sqlite3
import tempfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import cv2
import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from tossid import budget
from tossid.errors import FileError, InputError, brief
from tossid.vision.recordings.bag_records import ZSTD_MAGIC, Storage, Topic, open_storage, unpack, zstd
from tossid.vision.recordings.image_decoding import Pixels, grey_pixels
from tossid.yaml_files import read_yaml

SUFFIXES = (".bag", ".mcap", ".db3", ".bag.bz2", ".bag.gz")
PARTS = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")
PACKED: dict[str, Callable[[Path], Any]] = {".bz2": bz2.BZ2File, ".gz": gzip.GzipFile, ".zstd": zstd.open}
_AT_ONCE = 1 << 20
"""Bytes that are unpacked at once."""
_NESTED = 50
"""Messages inside one another."""

APRILTAG_MSGS = {
    "apriltag_msgs/msg/ApriltagArrayStamped": "std_msgs/Header header\nApriltag[] apriltags\n",
    "apriltag_msgs/msg/Apriltag": (
        "int32 id\nstring family\nint32 hamming\nint32 border\nint32 bits\n"
        "geometry_msgs/Point center\ngeometry_msgs/Point[4] corners\n"
    ),
    "apriltag_msgs/msg/AprilTagDetectionArray": "std_msgs/Header header\nAprilTagDetection[] detections\n",
    "apriltag_msgs/msg/AprilTagDetection": (
        "string family\nint32 id\nint32 hamming\nfloat32 goodness\nfloat32 decision_margin\n"
        "Point centre\nPoint[4] corners\nfloat64[9] homography\n"
    ),
    "apriltag_msgs/msg/Point": "float64 x\nfloat64 y\n",
}
"""Detections as TagSLAM's detector writes them, and as apriltag_ros does. ROS 1 bags, and ROS 2 bags of the mcap
kind, hold their own definitions; others do not."""

IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_GREY = {"mono8": None, "8UC1": None, "bgr8": cv2.COLOR_BGR2GRAY, "8UC3": cv2.COLOR_BGR2GRAY}
_GREY |= {"rgb8": cv2.COLOR_RGB2GRAY, "bgra8": cv2.COLOR_BGRA2GRAY, "rgba8": cv2.COLOR_RGBA2GRAY}
_GREY |= {"bayer_rggb8": cv2.COLOR_BayerBG2GRAY, "bayer_bggr8": cv2.COLOR_BayerRG2GRAY}
_GREY |= {"bayer_gbrg8": cv2.COLOR_BayerGR2GRAY, "bayer_grbg8": cv2.COLOR_BayerGB2GRAY}


def typestore() -> Typestore:
    """ROS 2's common messages and the AprilTag ones."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    types: dict[str, Any] = {}
    for name, text in APRILTAG_MSGS.items():
        types.update(get_types_from_msg(text, name))
    store.register(types)
    return store


def find_bags(path: Path) -> tuple[Path, ...]:
    """The bags that a path names: itself, or those in a folder beside their calibration.

    Raises:
        FileError: there is none.
    """
    if path.is_file() or is_bag_folder(path):
        return (path,)
    if not path.is_dir():
        raise FileError(path, "no such bag; expected a .bag, .bag.bz2 or .mcap file, or a ROS 2 bag's folder")
    inside = sorted(entry for entry in path.iterdir() if not entry.name.startswith("."))
    bags = [entry for entry in inside if is_bag_folder(entry)]
    bags += [entry for entry in inside if entry.is_file() and entry.name.endswith(SUFFIXES)]
    if not bags:
        raise FileError(path, "holds no bag; expected a .bag, .bag.bz2 or .mcap file, or a ROS 2 bag's folder")
    return tuple(bags)


def is_bag_folder(path: Path) -> bool:
    """Whether a folder is a ROS 2 bag: with metadata.yaml, or with nothing but the parts of one and no calibration."""
    if not path.is_dir():
        return False
    if (path / "metadata.yaml").is_file():
        return True
    names = {re.sub(r"(_\d+)?(\.\w+)+$", "", part.name) for part in bag_parts(path)}
    return len(names) == 1 and not (path / "cameras.yaml").is_file()


def bag_parts(folder: Path) -> list[Path]:
    """The files of a ROS 2 bag's messages, in order of their numbers."""
    parts = [entry for entry in folder.iterdir() if entry.is_file() and entry.name.endswith(PARTS)]
    return sorted(parts, key=lambda part: (len(part.name), part.name))


class Bag:
    """An open bag. Use it as a context.

    Attributes:
        path: As named.
        types: Message type of each topic, without a leading "/".
        problems: What could not be read.
    """

    def __init__(self, path: Path) -> None:
        """Name a bag; the context opens it."""
        self.path = path
        self.types: dict[str, str] = {}
        self.problems: list[str] = []
        self._stack = ExitStack()
        self._storages: list[Storage] = []
        self._readers: dict[Topic, Callable[[bytes], Any]] = {}

    def __enter__(self) -> Bag:
        """Open the bag.

        Raises:
            FileError: It is no bag, or so damaged that nothing can be read.
        """
        try:
            lacks = missing_metadata(self.path) if self.path.is_dir() else None
            for part in bag_parts(self.path) if self.path.is_dir() else [self.path]:
                file = self._settled(self._unpacked(part))
                storage = open_storage(file)
                self._storages.append(storage)
                self.types |= {topic.name: topic.kind for topic in storage.topics.values()}
                whole = f"{storage.count} messages are whole"
                whole += f", the last of {storage.last_ns * 1e-9:.3f} s" if storage.count else ""
                if storage.is_cut:
                    self.problems.append(f"{part} breaks off before its end: {whole}")
                elif lacks and file.suffix == ".db3":  # an MCAP tells by itself whether it is whole
                    self.problems.append(f"{self.path} {lacks}: {whole}")
        except BaseException as error:
            self._stack.close()
            if isinstance(error, FileError):
                raise FileError(self.path, "; ".join([error.problem, *self.problems])) from error
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the bag."""
        self._stack.close()

    def _settled(self, part: Path) -> Path:
        """A database with what a killed recorder left in SQLite's files beside it: a copy, where there are such."""
        beside = [part.with_name(part.name + end) for end in ("-wal", "-journal")]
        left = [file for file in beside if file.is_file() and budget.regular_size(file)]
        if not left:
            return part
        folder = Path(self._stack.enter_context(tempfile.TemporaryDirectory(prefix="tossid-bag-")))
        for file in (part, *left):
            shutil.copyfile(file, folder / file.name)
        try:
            with closing(sqlite3.connect(folder / part.name)) as database:
                database.execute("PRAGMA journal_mode=DELETE").fetchall()  # takes in the log, or rolls back
        except sqlite3.Error as error:
            raise FileError(part, f"does not go with {left[0].name}: {error}") from error
        return folder / part.name

    def _unpacked(self, path: Path) -> Path:
        """A file of a bag as it is, or unpacked to a temporary file."""
        size = budget.regular_size(path)
        if path.suffix not in PACKED:
            return path
        folder = Path(self._stack.enter_context(tempfile.TemporaryDirectory(prefix="tossid-bag-")))
        plain, limit = folder / path.stem, budget.unpacked_allowance(size)
        with plain.open("wb") as out:
            try:
                with PACKED[path.suffix](path) as packed:
                    while some := packed.read(_AT_ONCE):
                        out.write(some)
                        budget.check_claim(path, "bytes when unpacked", out.tell(), limit)
            except EOFError:
                self.problems.append(f"{path} is packed, and breaks off before its end")
            except (OSError, zlib.error, zstd.ZstdError) as error:
                raise FileError(path, f"cannot be unpacked: {error}") from error
        return plain

    def messages(self, topics: Sequence[str], *, start: int = 0, stop: int = 2**63 - 1) -> Iterator[Any]:
        """The messages of some topics, in order of recording.

        Args:
            topics: Without a leading "/".
            start: First time of recording [ns].
            stop: Time of recording [ns] before which it ends.

        Yields:
            Topic, time of recording [ns], message.

        Raises:
            FileError: The bag is damaged there.
        """
        try:
            for storage in self._storages:
                chosen = {number: topic for number, topic in storage.topics.items() if topic.name in topics}
                for message in storage.messages(chosen, start, stop) if chosen else ():
                    topic, data = chosen[message.topic], message.data
                    if data[:4] == ZSTD_MAGIC:  # a database may pack each of its messages
                        data = unpack(self.path, "zstd", data)
                    yield topic.name, message.t_ns, self._reader(topic)(data)
        except FileError as error:
            raise FileError(self.path, error.problem) from error
        except Exception as error:  # of damaged content, rosbags raises whatever it comes across
            raise FileError(self.path, f"is damaged: {_said(error)}; record or copy it again") from error

    def _reader(self, topic: Topic) -> Callable[[bytes], Any]:
        """What makes messages of a topic's data: by the bag's own definition of their type, if it has one."""
        if topic not in self._readers:
            store = get_typestore(Stores.EMPTY) if topic.definition else typestore()
            if topic.definition:
                store.register(get_types_from_msg(topic.definition, topic.kind))
                _check_definitions(self.path, store.fielddefs)
            read = store.deserialize_ros1 if topic.encoding == "ros1" else store.deserialize_cdr
            self._readers[topic] = lambda data: read(data, topic.kind)
        return self._readers[topic]


def missing_metadata(folder: Path) -> str | None:
    """What a ROS 2 bag's metadata.yaml lacks, None where it names topics and all of the folder's files.

    Raises:
        FileError: It names a file that is not there.
    """
    file, parts = folder / "metadata.yaml", {part.name.removesuffix(".zstd") for part in bag_parts(folder)}
    if not file.is_file():
        return "has no metadata.yaml"
    try:
        about = read_yaml(file).get("rosbag2_bagfile_information")
    except FileError:
        about = None
    if not isinstance(about, dict) or not about.get("topics_with_message_count"):
        return "has a metadata.yaml that names no topics"
    names = about.get("relative_file_paths")
    named = {Path(str(name)).name.removesuffix(".zstd") for name in names} if isinstance(names, list) else set()
    if named - parts:
        raise FileError(file, f"names {brief(min(named - parts))}, which is not there")
    return f"has a metadata.yaml that does not name {min(parts - named)}" if parts - named else None


def _check_definitions(path: Path, types: Mapping[str, Any]) -> None:
    """Refuse messages whose definition alone asks for too much, before code is made from it.

    A few bytes can announce billions of items that take none; and each item that is no plain number is an object.
    """
    for name in types:
        items, _ = _cost(path, types, (Nodetype.NAME, name), 0)
        what = f"items in a message of type {brief(name)}"
        budget.check_claim(path, what, items, budget.limits().message_items)


def _cost(path: Path, types: Mapping[str, Any], node: tuple[Any, Any], depth: int) -> tuple[int, int]:
    """Items that a field makes for itself, and least bytes that it takes."""
    kind, about = node
    if depth > _NESTED:
        raise FileError(path, f"a message holds others more than {_NESTED} deep")
    if kind == Nodetype.BASE:
        return (1, 4) if about[0] in ("string", "wstring") else (0, 1)
    if kind == Nodetype.NAME:
        if about not in types:
            return 0, 1
        fields = [_cost(path, types, field, depth + 1) for _, field in types[about][1]]
        return 1 + sum(items for items, _ in fields), sum(least for _, least in fields)
    inner, count = about
    items, least = _cost(path, types, inner, depth + 1)
    if not least:
        raise FileError(path, "a message claims a list of messages that hold nothing")
    return (count * items, count * least) if kind == Nodetype.ARRAY else (items, 4)


def _said(error: Exception) -> str:
    return str(error) or type(error).__name__


@contextmanager
def as_defined(path: Path, where: str, message: Any) -> Iterator[None]:
    """A block that reads a message's fields, as the bag's own definition of its type has them.

    Raises:
        FileError: The fields are not those of a type by that name, or hold what cannot be used.
    """
    try:
        yield
    except FileError:
        raise
    except InputError as error:
        raise FileError(path, f"{where}: {error}") from error
    except (AttributeError, TypeError, ValueError, OverflowError, IndexError, cv2.error) as error:
        what = f"a {message.__msgtype__} by another definition, or with other content, than its own"
        raise FileError(path, f"topic {where} holds {what} ({_said(error)})") from error


def stamp(message: Any, t_ns: int) -> int:
    """A message's own time [ns], or that of its recording where it has none."""
    own = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    return int(own or t_ns)


def grey_image(path: Path, message: Any) -> Pixels:
    """A sensor_msgs Image or CompressedImage as a grey image (height, width) of 8 or 16 bits.

    Raises:
        FileError: the image claims too many pixels.
        InputError: an encoding that is not known, or data that are no image.
    """
    if not hasattr(message, "encoding"):
        image = grey_pixels(path, np.asarray(message.data, dtype=np.uint8).tobytes())
        if image is None:
            raise InputError(f"a compressed image ('{message.format}') cannot be read")
        return image
    encoding = str(message.encoding)
    height, width, step = int(message.height), int(message.width), int(message.step)
    data = np.asarray(message.data, dtype=np.uint8)
    if encoding in ("mono16", "16UC1"):
        order = ">u2" if message.is_bigendian else "<u2"
        wide = data[: height * step].reshape(height, step)[:, : 2 * width].copy().view(order)
        return np.asarray(wide, dtype=np.uint16)
    if encoding not in _GREY:
        raise InputError(f"image encoding '{encoding}' is not one of {', '.join([*_GREY, 'mono16'])}")
    code = _GREY[encoding]
    channels = 1 if code is None or encoding.startswith("bayer") else 4 if encoding.endswith("a8") else 3
    if len(data) < height * step or step < width * channels:
        raise InputError(f"an image of {width} by {height} px has only {len(data)} bytes")
    rows = data[: height * step].reshape(height, step)[:, : width * channels]
    image = rows if channels == 1 else rows.reshape(height, width, channels)
    grey = image if code is None else cv2.cvtColor(np.ascontiguousarray(image), code)
    return np.ascontiguousarray(grey, dtype=np.uint8)
