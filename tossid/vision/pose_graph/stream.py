"""Tracking a long recording in pieces, so that memory does not grow with it.

Where clocks agree and everything static is exactly known, time steps share nothing. Pieces of some seconds are then
tracked one after another as detections come in; their poses and their part of the report are kept. Otherwise a
recording is tracked as a whole, unless it is long: then stretches from all over it calibrate what is static, and the
clocks, and the pieces follow with the result as their prior.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np

from tossid.errors import InputError
from tossid.rotations import quat_continuous
from tossid.settings.tracking import StreamSettings, TrackSettings
from tossid.types import Detection, PoseTrack
from tossid.vision.cameras.camera import Camera
from tossid.vision.pose_graph.clocks import Clocks, clock_offsets
from tossid.vision.pose_graph.report import FrameErrors, TrackReport
from tossid.vision.pose_graph.setup_checks import Suspect
from tossid.vision.pose_graph.state import Prior
from tossid.vision.pose_graph.track import DEFAULT, Tracked, track_in_time
from tossid.vision.recordings.disk_buffer import DetectionSpool
from tossid.vision.setup.layout import TagLayout


def track_stream(
    detections: Iterable[Detection],
    cameras: Sequence[Camera],
    layout: TagLayout,
    *,
    settings: TrackSettings = DEFAULT,
    name: str | None = None,
    progress: Callable[[int], None] | None = None,
    keep: Callable[[str, PoseTrack], None] | None = None,
    spool_folder: Path | None = None,
) -> Tracked:
    """The same as `track_scene`, from detections as they come.

    Args:
        detections: In order of time, to within `StreamSettings.disorder`, where everything static is known or the
            recording is long; else in any order. If they are needed more than once and come from an iterator, a
            temporary file keeps them.
        cameras: What is known of them.
        layout: What is known of bodies and their tags.
        settings: When poses are accepted, and what is long.
        name: Of the track, where there is one moving body.
        progress: Called with the number of poses found since the last call.
        keep: Called with a moving body's name and the next stretch of its track; the result then has no tracks.
        spool_folder: Where the temporary file lies; None: in the system's folder for these.

    Raises:
        InputError: As `track_scene`, if no piece gives a pose.
    """
    with ExitStack() as stack:
        if isinstance(detections, Iterator) and needs_all(cameras, layout, settings=settings):
            file = stack.enter_context(tempfile.TemporaryFile(dir=spool_folder))
            detections = DetectionSpool(detections, file)
        clocks = clock_offsets(detections, cameras, layout, settings=settings) if settings.clocks else Clocks()
        tracked = _in_pieces(detections, cameras, layout, settings, name, progress, _Tracks(keep), clocks)
    return replace(tracked, report=replace(tracked.report, clock_doubts=clocks.doubts))


def needs_all(cameras: Sequence[Camera], layout: TagLayout, *, settings: TrackSettings) -> bool:
    """Whether all detections are needed before the first pose: to calibrate what is static, or to compare clocks."""
    return not statics_known(cameras, layout) or (settings.clocks and len(cameras) > 1)


def _in_pieces(
    detections: Iterable[Detection],
    cameras: Sequence[Camera],
    layout: TagLayout,
    settings: TrackSettings,
    name: str | None,
    progress: Callable[[int], None] | None,
    tracks: _Tracks,
    clocks: Clocks,
) -> Tracked:
    """Tracking of cameras whose clocks are apart as `clocks` says, but for a rest that is estimated."""
    sizes, statics = settings.stream, None
    if clocks.offsets or not statics_known(cameras, layout):
        in_time = clocks.in_time(detections)
        sample = _sample(in_time, sizes)
        whole = list(sample or in_time)
        statics = track_in_time(whole, cameras, layout, settings=settings, name=name, subtracted=clocks.offsets)
        if sample is None:
            tracks.extend(statics.tracks)
            if progress is not None:
                progress(statics.report.n_poses)
            return replace(statics, tracks=tracks.whole())
        del sample, whole  # frees their memory
        cameras, layout = statics.cameras, statics.layout
        clocks = Clocks({camera: offset for camera, (offset, _) in statics.report.clocks.items()})
    done: list[Tracked] = []
    failed: list[InputError] = []
    for piece in _pieces(clocks.in_time(detections), sizes):
        try:
            tracked = track_in_time(piece, cameras, layout, settings=settings, name=name)
        except InputError as error:  # no body is seen for a while
            failed.append(error)
            continue
        tracks.extend(tracked.tracks)
        statics = statics or tracked
        done.append(replace(tracked, tracks={}, cameras=(), layout=layout))
        if progress is not None:
            progress(tracked.report.n_poses)
    if statics is None or not done:
        raise failed[0] if failed else InputError("no detection of any tag of the scene: nothing to track")
    unseen = {f"in {len(failed)} stretches of {sizes.piece:g} s without a pose": len(failed)} if failed else {}
    return _joined(done, statics, tracks.whole(), unseen)


def _sample(detections: Iterable[Detection], sizes: StreamSettings) -> list[Detection] | None:
    """Detections of stretches from all over a recording; None where it is short enough to be tracked as a whole."""
    t = np.unique(np.fromiter((d.t for d in detections), dtype=float))
    if len(t) <= sizes.whole_frames:
        return None
    starts = np.linspace(0, len(t) - sizes.stretch_frames, sizes.stretches).astype(np.int64)
    first, last = t[starts], t[starts + sizes.stretch_frames - 1]

    def chosen(time: float) -> bool:
        i = int(np.searchsorted(first, time, side="right")) - 1
        return i >= 0 and time <= last[i]

    return [d for d in detections if chosen(d.t)]


def statics_known(cameras: Sequence[Camera], layout: TagLayout) -> bool:
    """Whether everything static is exactly known."""
    wiggles = any(one.wiggle is not None for one in cameras)
    known = [Prior.of_camera(camera) for camera in cameras]
    known += [Prior.of_body(body) for body in layout.bodies if body.is_static]
    known += [Prior.of_tag(tag) for body in layout.bodies for tag in body.tags]
    return layout.default_body is None and not wiggles and all(one is not None and one.exact for one in known)


def _pieces(detections: Iterable[Detection], sizes: StreamSettings) -> Iterator[list[Detection]]:
    """Stretches of time, in order, each cut at the widest gap between frames near its full length."""
    source, waiting = iter(detections), list[Detection]()
    while True:
        first = min((d.t for d in waiting), default=np.inf)
        newest = max((d.t for d in waiting), default=-np.inf)
        for d in source:
            first, newest = min(first, d.t), max(newest, d.t)
            waiting.append(d)
            if newest > first + sizes.piece + sizes.disorder:
                break
        end = first + sizes.piece
        if newest <= end + sizes.disorder:  # the source has no more
            if waiting:
                yield waiting
            return
        t = np.unique([d.t for d in waiting if end - sizes.border < d.t <= end])
        gap = int(np.argmax(np.diff(t))) if len(t) > 1 else -1
        border = 0.5 * (t[gap] + t[gap + 1]) if gap >= 0 else end
        yield [d for d in waiting if d.t <= border]
        waiting = [d for d in waiting if d.t > border]


class _Tracks:
    """Tracks by body, continued from piece to piece so that quaternions keep their sign and joints their turns."""

    def __init__(self, keep: Callable[[str, PoseTrack], None] | None) -> None:
        self._parts: dict[str, list[PoseTrack]] = {}
        self._last: dict[str, np.ndarray] = {}
        self._keep = keep or (lambda body, part: self._parts.setdefault(body, []).append(part))

    def extend(self, tracks: dict[str, PoseTrack]) -> None:
        """Append the next piece's tracks."""
        for body, part in tracks.items():
            if body in self._last:
                q = np.concatenate([self._last[body], part.q])
                q[:, 3:7] = quat_continuous(q[:, 3:7])
                q[:, 7:] = np.unwrap(q[:, 7:], axis=0)
                part = replace(part, q=q[1:])
            self._last[body] = part.q[-1:].copy()
            self._keep(body, part)

    def whole(self) -> dict[str, PoseTrack]:
        """All tracks; none where `keep` took them."""
        return {body: _one_track(parts) for body, parts in self._parts.items()}


def _one_track(parts: Sequence[PoseTrack]) -> PoseTrack:
    if len(parts) == 1:
        return parts[0]
    covs = [part.q_cov for part in parts if part.q_cov is not None]
    t, q = np.concatenate([part.t for part in parts]), np.concatenate([part.q for part in parts])
    return PoseTrack(parts[0].name, t, q, np.concatenate(covs))


def _joined(
    done: Sequence[Tracked],
    statics: Tracked,
    tracks: dict[str, PoseTrack],
    unseen: dict[str, int],
) -> Tracked:
    """The pieces one after another, with what is static from `statics`. unseen: count of pieces without any pose."""
    frames = FrameErrors(
        *(np.concatenate([getattr(d.frames, field) for d in done]) for field in ("t", "camera", "rms", "tags"))
    )
    report = _one_report([d.report for d in done], statics.report, frames, [camera.name for camera in statics.cameras])
    report.dropped_tags.update(unseen)
    return Tracked(tracks, statics.cameras, statics.layout, frames, report)


def _one_report(
    reports: Sequence[TrackReport], found: TrackReport, frames: FrameErrors, cameras: Sequence[str]
) -> TrackReport:
    """Sums and worst cases; a tag's reprojection is the mean over pieces, weighted by their poses.

    found: the report on what is static, and on the suspects of its stretches.
    """

    def rms(own: np.ndarray) -> float:
        return float(np.sqrt(np.average(frames.rms[own] ** 2, weights=frames.tags[own])))

    def rms_of_tag(tag_id: int) -> float:
        own = [report for report in reports if tag_id in report.rms_by_tag]
        squares, weights = (
            [report.rms_by_tag[tag_id] ** 2 for report in own],
            [max(report.n_poses, 1) for report in own],
        )
        return float(np.sqrt(np.average(squares, weights=weights)))

    def total(counts: Iterable[Mapping[str, int]]) -> dict[str, int]:
        sums = Counter[str]()
        for count in counts:
            sums.update(count)
        return dict(sums)

    tags = sorted({tag_id for report in reports for tag_id in report.rms_by_tag})
    seen = [c for c in range(len(cameras)) if (frames.tags[frames.camera == c] > 0).any()]
    suspects: dict[tuple[str, str], Suspect] = {}
    for suspect in (suspect for report in (found, *reports) for suspect in report.suspects):
        suspects.setdefault((suspect.kind, suspect.name), suspect)
    whole = rms(frames.tags > 0)
    return replace(
        found,
        n_steps=sum(report.n_steps for report in reports),
        n_poses=sum(report.n_poses for report in reports),
        rms=whole,
        rms_axis=whole / 2**0.5,
        rms_by_camera={cameras[c]: rms(frames.camera == c) for c in seen},
        rms_by_tag={tag_id: rms_of_tag(tag_id) for tag_id in tags},
        noise_scale=float(np.median([report.noise_scale for report in reports])),
        sightings=total(report.sightings for report in reports),
        left_out={
            camera: total(report.left_out.get(camera, {}) for report in reports)
            for camera in dict.fromkeys(name for report in reports for name in report.left_out)
        },
        dropped_steps=total(report.dropped_steps for report in reports),
        dropped_tags=total(report.dropped_tags for report in reports),
        worst_frames=sorted((row for report in reports for row in report.worst_frames), key=lambda row: -row[2])[:10],
        unplaced=[name for name in reports[0].unplaced if all(name in report.unplaced for report in reports)],
        suspects=list(suspects.values()),
        spread=reports[0].spread,
        rms_bare=reports[0].rms_bare,
    )
