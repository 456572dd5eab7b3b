"""The format `video`: a recording with one video file a camera."""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tossid.errors import FileError
from tossid.settings.kinds import Positive
from tossid.vision.recordings.registry import Opened, register_recording

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from tossid.vision.cameras.camera import Camera
    from tossid.vision.recordings.film import FilmDecoder, FilmIndex
    from tossid.vision.recordings.recording import FrameFile, Recording

    Image = NDArray[np.uint8]

VIDEO_SUFFIXES = (".mp4", ".avi", ".mkv", ".mov", ".m4v", ".webm")
RATES_DIFFER = 0.02
"""Relative difference from which on a stated rate is not that of a film's times."""


@dataclass(frozen=True, kw_only=True)
class VideoSource:
    """Videos of the tagged object, one file a camera, with the cameras' calibration and the tags' layout."""

    name: Literal["video"] = "video"
    """videos"""
    path: Path
    """recording folder: CAMERA.mp4 for each camera, CAMERA.txt with its frames' times beside, or none"""
    rate_hz: Positive | None = None
    """frames a second as they were taken, of videos that play slower or faster (slow motion): their times are
    stretched to it; null: the videos' own times"""


class VideoFiles:
    """Frames of films, one file a camera, by their time stamps."""

    def __init__(self, films: Mapping[Path, FilmIndex], turns: Mapping[Path, int]) -> None:
        """Read films.

        Args:
            films: Index of each.
            turns: Quarter turns that the images of each are given.
        """
        self._films, self._turns = films, turns
        self._idle: dict[Path, list[FilmDecoder]] = defaultdict(list)
        self._lock = threading.Lock()

    def images(self, files: Sequence[FrameFile]) -> Iterator[Image | None]:
        """Frames of one film; None for those that cannot be decoded.

        A decoder that comes free waits where it is, so that frames asked for in order are decoded about once.
        """
        if not files:
            return
        path = files[0].path
        decoder = self._decoder(path, files[0].index)
        try:
            for file in files:
                yield decoder.image(file.index)
        finally:
            with self._lock:
                self._idle[path].append(decoder)

    def _decoder(self, path: Path, pts: int) -> FilmDecoder:
        """The idle decoder that has the least way to a frame, or a new one."""
        from tossid.vision.recordings.film import FilmDecoder

        with self._lock:
            idle = self._idle[path]
            if idle:
                best = max(idle, key=lambda decoder: (decoder.at <= pts, decoder.at))
                idle.remove(best)
                return best
        return FilmDecoder(self._films[path], turns=self._turns[path])


def read_videos(folder: str | Path, *, rate_hz: float | None = None) -> Recording:
    """Open a recording of one video a camera: NAME/CAMERA.mp4 (or .avi, .mkv, .mov), with its calibration.

    A frame's time is a line of CAMERA.txt or CAMERA.csv beside the video, where there is one; else the time at which
    the video shows it. Images are turned as the video's metadata say, unless the camera was calibrated without that.

    Args:
        folder: Where the videos and the calibration lie.
        rate_hz: Frames a second as they were taken, where videos without a file of times play at another rate.

    Returns:
        The recording; its problems say which of its rates and turns do not go together.

    Raises:
        FileError: A camera has no video, it cannot be read or has another size than the camera, or it and its times
            differ in length.
    """
    from tossid.vision.recordings.film import index_film
    from tossid.vision.recordings.recording import Recording, read_set_up

    folder = Path(folder)
    cameras, layout = read_set_up(folder)
    paths = {camera.name: _video_path(folder, camera) for camera in cameras}
    films = {path: index_film(path) for path in paths.values()}
    problems: list[str] = []
    turns = {path: _turns(films[path], camera, problems) for camera, path in zip(cameras, paths.values(), strict=True)}
    frames = {camera.name: _listed(films[paths[camera.name]], camera, rate_hz, problems) for camera in cameras}
    return Recording(folder, cameras, layout, frames, VideoFiles(films, turns), tuple(problems))


def _video_path(folder: Path, camera: Camera) -> Path:
    names = [folder / f"{camera.name}{suffix}" for suffix in VIDEO_SUFFIXES]
    path = next((name for name in names if name.is_file()), None)
    if path is None:
        raise FileError(folder, f"has no video of camera '{camera.name}'; expected {names[0].name} or alike")
    return path


def _turns(film: FilmIndex, camera: Camera, problems: list[str]) -> int:
    """Quarter turns by which a film's images are those that its camera was calibrated with."""
    if film.shown == camera.resolution:
        if film.turns:
            problems.append(
                f"{film.path}: its images are turned by {90 * film.turns}° as its metadata say; {camera.name} must "
                "have been calibrated with images that were turned alike"
            )
        return film.turns
    if film.size == camera.resolution:
        problems.append(
            f"{film.path}: its images are left as they are stored, as {camera.name} was calibrated; its metadata turn "
            f"them by {90 * film.turns}°"
        )
        return 0
    width, height = film.shown
    raise FileError(
        film.path,
        f"is {width} by {height} px, but {camera.name} has {camera.resolution[0]} by {camera.resolution[1]} px",
    )


def _listed(film: FilmIndex, camera: Camera, rate_hz: float | None, problems: list[str]) -> Sequence[FrameFile]:
    """A film's frames in order of time."""
    import numpy as np

    from tossid.vision.recordings.recording import frames_in_order
    from tossid.vision.recordings.times import evened, read_times, usual_rate

    path, pts = film.path, film.pts
    beside = next((path.with_suffix(suffix) for suffix in (".txt", ".csv") if path.with_suffix(suffix).is_file()), None)
    stated = [("cameras.yaml", camera.rate_hz), ("source.rate_hz", rate_hz)]
    if beside is not None:
        t_ns, whose = read_times(beside).times(len(pts), f"the {len(pts)} frames of {path.name}"), beside.name
    else:
        t_ns, whose = evened(np.array(film.t_ns, dtype=np.int64), float(film.tick) * 1e9), "the video"
        own = usual_rate(t_ns)
        if rate_hz is not None and own is not None:
            t_ns = t_ns[0] + np.round((t_ns - t_ns[0]) * (own / rate_hz)).astype(np.int64)
            if abs(own / rate_hz - 1) > RATES_DIFFER:
                problems.append(f"{path}: plays at {own:.4g} Hz; its times are stretched to source.rate_hz={rate_hz:g}")
    own = usual_rate(t_ns)
    for where, rate in stated:
        if rate and own and abs(own / rate - 1) > RATES_DIFFER:
            problems.append(
                f"{path}: {where} says {rate:g} Hz for {camera.name}, but the times of {whose} say {own:.4g} Hz; these "
                "hold (source.rate_hz=... stretches the times of a slow-motion video)"
            )
    return frames_in_order(camera, t_ns, lambda i: path, lambda i: int(pts[i]))


def _open(source: VideoSource) -> Opened:
    return Opened.of(read_videos(source.path, rate_hz=source.rate_hz), source.path)


def _has_videos(path: Path) -> bool:
    if not path.is_dir() or (path / "frames").exists() or (path / "metadata.yaml").is_file():
        return False
    return any(entry.name.endswith(VIDEO_SUFFIXES) for entry in path.iterdir())


register_recording(VideoSource, _open, recognizes=_has_videos)
