"""ROS 1 and ROS 2 bags opened without ROS, by the `rosbags` library.

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
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import cv2
import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from tossid import budget
from tossid.errors import FileError, InputError
from tossid.vision.recordings.image_header import Pixels, grey_pixels
from tossid.vision.recordings.rosbag_budget import (
    ZSTD_MAGIC,
    TooLarge,
    ZstdError,
    check_definitions,
    check_parts,
    copy_within,
    forget_excess,
    missing_metadata,
    open_zstd,
    unpack_zstd,
)
from tossid.vision.recordings.rosbag_rescue import Rescue, RescuedMcap, whole_words

SUFFIXES = (".bag", ".mcap", ".db3", ".bag.bz2", ".bag.gz")
PARTS = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")
PACKED: dict[str, Callable[[Path], Any]] = {".bz2": bz2.BZ2File, ".gz": gzip.GzipFile, ".zstd": open_zstd}

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
        self._reader: AnyReader | None = None
        self._rescued: Rescue | None = None
        self._bare = ""
        """what its metadata lack"""

    def __enter__(self) -> Bag:
        """Open the bag.

        Raises:
            FileError: It is no bag, or so damaged that nothing can be read.
        """
        forget_excess()
        try:
            plain = self._unpacked(self.path)
            if plain.suffix != ".bag" or plain.is_dir():
                reader = AnyReader(self._parts(plain), default_typestore=typestore())
                self._reader = self._stack.enter_context(reader)
                self._say_what_is_whole(self._reader)
            else:
                try:
                    self._reader = self._stack.enter_context(AnyReader([plain]))
                except Exception as error:  # as below
                    self._rescued = Rescue(plain)
                    if not self._rescued.types():
                        raise FileError(self.path, f"is not a bag that can be read ({_said(error)})") from error
            if self._reader is not None:
                check_definitions(self._reader.typestore.fielddefs)
                self.types = {c.topic.lstrip("/"): c.msgtype for c in self._reader.connections}
            elif self._rescued is not None:
                self.types = self._rescued.types()
                self.problems.append(f"{self.path} breaks off before its end: {self._rescued.found}")
        except Exception as error:  # of a damaged bag, rosbags raises whatever it comes across, MemoryError among it
            self._stack.close()
            if isinstance(error, FileError):
                raise
            if isinstance(error, TooLarge):
                raise FileError(self.path, str(error)) from error
            lost = f"; {self.problems[0]}" if self.problems else ""
            raise FileError(self.path, f"is not a bag that can be read ({_said(error)}{lost})") from error
        except BaseException:
            self._stack.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the bag."""
        self._stack.close()

    def _parts(self, plain: Path) -> list[Path]:
        """A ROS 2 bag as `rosbags` opens it: its folder, or its files where metadata are missing or not whole."""
        if plain.is_file():
            return [self._settled(plain)]
        parts = bag_parts(plain)
        lacks = missing_metadata(plain, [part.name for part in parts])
        if lacks is None or not parts:
            check_parts(plain)
            return [plain]
        self._bare = f"{self.path} {lacks}"
        return [self._settled(self._unpacked(part)) for part in parts]

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

    def _say_what_is_whole(self, reader: AnyReader) -> None:
        inner: list[Any] = [one.storage for one in reader.readers]  # type: ignore[union-attr]
        storages = [part for storage in inner for part in getattr(storage, "storages", [storage])]
        cut = [storage for storage in storages if getattr(storage, "found", None)]
        self.problems += [f"{storage.path} breaks off before its end: {storage.found}" for storage in cut]
        # an MCAP tells by itself whether it is whole
        if self._bare and not all(isinstance(storage, RescuedMcap) for storage in storages):
            self.problems.append(f"{self._bare}: {whole_words(reader.message_count, reader.end_time - 1)}")

    def _unpacked(self, path: Path) -> Path:
        """A bag as a plain file or folder; a packed one is unpacked to a temporary file."""
        size = None if path.is_dir() else budget.regular_size(path)
        if size is None or path.suffix not in PACKED:
            return path
        folder = Path(self._stack.enter_context(tempfile.TemporaryDirectory(prefix="tossid-bag-")))
        plain = folder / path.stem
        with plain.open("wb") as out:
            try:
                with PACKED[path.suffix](path) as packed:
                    copy_within(packed, out, budget.unpacked_allowance(size))
            except EOFError:
                self.problems.append(f"{path} is packed, and breaks off before its end")
            except TooLarge as error:
                raise FileError(path, str(error)) from error
            except (OSError, zlib.error, ZstdError) as error:
                raise FileError(path, f"cannot be unpacked: {error}") from error
        return plain

    def messages(self, topics: Sequence[str], *, start: int | None = None, stop: int | None = None) -> Iterator[Any]:
        """The messages of some topics, in order of recording.

        Args:
            topics: Without a leading "/".
            start: First time of recording [ns]; None for the bag's.
            stop: Time of recording [ns] before which it ends; None for the bag's end.

        Yields:
            Topic, time of recording [ns], message.

        Raises:
            FileError: The bag is damaged there.
        """
        try:
            if self._rescued is not None:
                for topic, t_ns, message in self._rescued.messages(topics):
                    if (start is None or t_ns >= start) and (stop is None or t_ns < stop):
                        yield topic, t_ns, message
                return
            assert self._reader is not None
            chosen: list[Connection] = [c for c in self._reader.connections if c.topic.lstrip("/") in topics]
            if chosen:
                for connection, t_ns, raw in self._reader.messages(chosen, start=start, stop=stop):
                    if self._reader.is2 and raw[:4] == ZSTD_MAGIC:  # as missing metadata would say
                        raw = unpack_zstd(raw)
                    yield connection.topic.lstrip("/"), t_ns, self._reader.deserialize(raw, connection.msgtype)
        except TooLarge as error:
            raise FileError(self.path, str(error)) from error
        except Exception as error:
            raise FileError(self.path, f"is damaged: {_said(error)}; record or copy it again") from error


def _said(error: Exception) -> str:
    return str(error) or type(error).__name__


@contextmanager
def as_defined(path: Path, where: str, message: Any) -> Iterator[None]:
    """A block that reads a message's fields, as the bag's own definition of its type has them.

    Args:
        path: The bag, for the error.
        where: The topic, for the error.
        message: What is read.

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

    Args:
        path: The bag, for the error.
        message: The message.

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
