"""Films decoded by PyAV (FFmpeg): which frames a video file has and when they are shown, and their images.

A frame is known by its presentation time stamp (pts), which its container states in a unit of its own, the tick. It is
never known by a number: dropped frames, a varying rate and B-frames leave numbers and times without a relation.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

from tossid import budget
from tossid.errors import FileError

Stamps = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class FilmIndex:
    """What a film has, from its packets; nothing but its first frame is decoded.

    Attributes:
        path: The film.
        pts: Time stamps of its frames, in order [ticks].
        keys: Those of its keyframes: the frames that can be decoded without others.
        tick: The container's unit of time [s].
        size: Width and height of its images as they are stored [px].
        turns: Quarter turns, counterclockwise, by which its metadata say that it is shown.
    """

    path: Path
    pts: Stamps
    keys: Stamps
    tick: Fraction
    size: tuple[int, int]
    turns: int

    @property
    def shown(self) -> tuple[int, int]:
        """Width and height of its images as players show them [px]."""
        return self.size[::-1] if self.turns % 2 else self.size

    @property
    def t_ns(self) -> list[int]:
        """When its frames are shown [ns]."""
        return [round(int(pts) * self.tick * 10**9) for pts in self.pts]


def index_film(path: Path) -> FilmIndex:
    """Count a film's frames by reading it through: what its header says may be a guess, or miss.

    Returns:
        Its frames, less those that the container hides (an edit list's).

    Raises:
        FileError: It is no film, has no frames, states no times, or two frames have one time.
    """
    budget.regular_size(path)
    pts, keys, untimed = array("q"), array("q"), 0
    try:
        with av.open(str(path)) as container:
            stream = _video_of(path, container)
            first = next(_decoded(container, stream), None)
            if first is None:
                raise FileError(path, "is a video without frames that can be decoded")
            budget.check_pixels(path, first.width, first.height)
            tick = stream.time_base
            assert tick is not None
        with av.open(str(path)) as container:
            for packet in _packets(container, _video_of(path, container)):
                if packet.is_discard or not packet.size:
                    continue
                if packet.pts is None:
                    untimed += 1
                else:
                    pts.append(packet.pts)
                    if packet.is_keyframe:
                        keys.append(packet.pts)
    except (av.error.FFmpegError, OSError) as error:
        raise FileError(path, f"is not a video that can be read ({error.strerror or error})") from error
    if untimed:
        raise FileError(path, f"states no times for {untimed} of its frames; convert it, to .mp4 or .mkv for example")
    stamps = np.sort(np.array(pts, dtype=np.int64))
    twice = np.flatnonzero(np.diff(stamps) == 0)
    if len(twice):
        when = float(int(stamps[twice[0]]) * tick)
        raise FileError(path, f"has two frames at {when:.6f} s: its times are in steps of {1e3 * float(tick):g} ms")
    turns = round(first.rotation / 90) % 4
    return FilmIndex(path, stamps, np.sort(np.array(keys, dtype=np.int64)), tick, (first.width, first.height), turns)


class FilmDecoder:
    """An open film that is decoded forward, from frame to frame."""

    def __init__(self, index: FilmIndex, *, turns: int) -> None:
        """Open a film at its beginning.

        Raises:
            FileError: It cannot be read any more.
        """
        self.index, self.turns = index, turns
        self._open()

    def _open(self) -> None:
        try:
            self._container = av.open(str(self.index.path))
        except (av.error.FFmpegError, OSError) as error:
            raise FileError(self.index.path, f"cannot be read: {error}") from error
        self._stream = _video_of(self.index.path, self._container)
        self._begin(-np.inf)

    def _begin(self, passed: float) -> None:
        self._frames = _decoded(self._container, self._stream)
        self._passed = passed
        """the stamp up to which all frames were passed [ticks]"""
        self._next = next(self._frames, None)

    @property
    def at(self) -> float:
        """The time stamp of the frame that comes next [ticks]; infinite at the end."""
        return np.inf if self._next is None or self._next.pts is None else self._next.pts

    def image(self, pts: int) -> NDArray[np.uint8] | None:
        """The image of one frame.

        Frames in ascending order are decoded once each; for another order, from the keyframe before.

        Args:
            pts: Its time stamp [ticks].

        Returns:
            (height, width) grey levels; None where it cannot be decoded: the film is damaged there.

        Raises:
            FileError: Frames come in another order than that of their times.
        """
        before = int(np.searchsorted(self.index.keys, pts, side="right"))
        key = int(self.index.keys[before - 1] if before else self.index.pts[0])
        if pts <= self._passed or key > self.at:
            self._seek(key)
        while self.at < pts:
            self._passed = self.at
            self._next = next(self._frames, None)
            if self.at <= self._passed:
                raise FileError(
                    self.index.path,
                    "stores times that do not go with its frames (B-frames in AVI do so); convert it with the "
                    "program that wrote it, or encode it anew as .mp4 or .mkv",
                )
        if self._next is None or self.at > pts or self._next.is_corrupt:
            return None
        grey = self._next.to_ndarray(format="gray")
        return np.ascontiguousarray(np.rot90(grey, self.turns), dtype=np.uint8)

    def _seek(self, key: int) -> None:
        """Go to a keyframe, or to the beginning where the container's index leads past it."""
        try:
            self._container.seek(key, stream=self._stream)
        except av.error.FFmpegError:
            self._open()
            return
        self._begin(key - 1)
        if self.at > key:
            self._container.close()
            self._open()


def _video_of(path: Path, container: av.container.InputContainer) -> av.VideoStream:
    if not container.streams.video:
        raise FileError(path, "has no video in it")
    stream = container.streams.video[0]
    stream.codec_context.options = {"max_pixels": str(budget.limits().pixels)}
    return stream


def _packets(container: av.container.InputContainer, stream: av.VideoStream) -> Iterator[av.Packet]:
    """The packets of a film up to where it breaks off; the last one, without content, gets what a decoder held back."""
    try:
        yield from container.demux(stream)
    except av.error.FFmpegError:
        return


def _decoded(container: av.container.InputContainer, stream: av.VideoStream) -> Iterator[av.VideoFrame]:
    """The frames that can be decoded, in the order in which they are shown."""
    for packet in _packets(container, stream):
        try:
            yield from (frame for frame in packet.decode() if frame.pts is not None)
        except av.error.FFmpegError:
            continue
