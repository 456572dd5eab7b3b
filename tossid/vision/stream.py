"""Tracking a long recording piece by piece, so that memory does not grow with it.

Where all that is static is exactly known, time steps share nothing but the clocks' offsets: pieces of some seconds are
tracked one after another as detections come in, and all that is kept of them is their poses and what the report says.
Otherwise a recording is tracked as a whole, unless it is long: then stretches from all over it tell what is static, and
the pieces follow with that as their prior.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from tossid.errors import InputError
from tossid.rotations import quat_continuous
from tossid.types import Detection, PoseTrack
from tossid.vision.believed import TrackSettings
from tossid.vision.camera import Camera
from tossid.vision.checks import Suspect
from tossid.vision.layout import TagLayout
from tossid.vision.priors import EXACT
from tossid.vision.report import Frames, TrackReport
from tossid.vision.track import DEFAULT, Tracked, track_scene

PIECE = 20.0
"""Length of a piece [s]."""
LATE = 2.0
"""Detections come in order of time, but for so much [s]."""
LONG = 12_000
"""Times of frames up to which a recording is tracked as a whole where something static is to be found."""
STRETCHES, STRETCH = 20, 600
"""Of a longer one, so many stretches of so many times of frames tell what is static."""
BORDER = 0.5
"""A piece ends at the widest gap between frames within so long of its full length [s]."""


def track_stream(
    detections: Iterable[Detection],
    cameras: Sequence[Camera],
    layout: TagLayout,
    *,
    settings: TrackSettings = DEFAULT,
    name: str | None = None,
    progress: Callable[[int], None] | None = None,
    keep: Callable[[str, PoseTrack], None] | None = None,
) -> Tracked:
    """As `track_scene`, of detections as they come.

    Args:
        detections: in order of time, but for `LATE`, where all that is static is known, or the recording is `LONG`;
            else in any order. Where they are needed more than once and come from an iterator, they are kept in memory.
        progress: called with the number of poses found since the last call.
        keep: takes poses as they are found, a moving body's name and the next stretch of its track; what is returned
            then has no tracks.

    Raises:
        InputError: as `track_scene`, if no piece gives a pose.
    """
    tracks = _Tracks(keep)
    pieces, looking, statics = _Pieces(detections), settings.clocks, None
    if not settled(cameras, layout):
        detections = list(detections) if isinstance(detections, Iterator) else detections
        sample = _sample(detections) if all(body.stillness is None for body in layout.bodies) else None
        statics = track_scene(list(sample or detections), cameras, layout, settings=settings, name=name)
        if sample is None:
            tracks.go_on(statics.tracks)
            if progress is not None:
                progress(statics.report.n_poses)
            return replace(statics, tracks=tracks.whole())
        del sample  # what follows takes no memory of it
        cameras, layout = statics.cameras, statics.layout
        pieces, looking = _Pieces(detections, statics.report.clocks), False
    done: list[Tracked] = []
    failed: list[InputError] = []
    while piece := pieces.take():
        try:
            tracked = track_scene(piece, cameras, layout, settings=replace(settings, clocks=looking), name=name)
        except InputError as error:  # nothing to be seen for a while
            failed.append(error)
            continue
        if tracked.report.clocks:  # from here on they are known, and the piece is cut anew
            looking, pieces.clocks = False, tracked.report.clocks
            pieces.put_back(piece)
            continue
        tracks.go_on(tracked.tracks)
        statics = statics or tracked
        done.append(replace(tracked, tracks={}, cameras=(), layout=layout))
        if progress is not None:
            progress(tracked.report.n_poses)
    if statics is None or not done:
        raise failed[0] if failed else InputError("no detection of any tag of the scene: nothing to track")
    return _joined(done, statics, tracks.whole(), pieces.clocks, len(failed))


def _sample(detections: Iterable[Detection]) -> list[Detection] | None:
    """Those of stretches all over a recording; None where it is not `LONG`."""
    t = np.unique(np.fromiter((d.t for d in detections), dtype=float))
    if len(t) <= LONG:
        return None
    starts = np.linspace(0, len(t) - STRETCH, STRETCHES).astype(np.int64)
    first, last = t[starts], t[starts + STRETCH - 1]

    def chosen(time: float) -> bool:
        i = int(np.searchsorted(first, time, side="right")) - 1
        return i >= 0 and time <= last[i]

    return [d for d in detections if chosen(d.t)]


def settled(cameras: Sequence[Camera], layout: TagLayout) -> bool:
    """Whether all that is static is exactly known, and nothing else ties time steps together."""
    known = all(camera.T_rig_cam is not None and _exact(camera.T_rig_cam_cov) for camera in cameras)
    known &= all(camera.wiggle is None for camera in cameras)
    for body in layout.bodies:
        known &= body.stillness is None
        if body.is_static:
            known &= body.T_map_body is not None and _small(body.position_noise) and _small(body.rotation_noise)
        for tag in body.tags:
            known &= tag.T_body_tag is not None and _small(tag.position_noise) and _small(tag.rotation_noise)
    return known and layout.default_body is None


def _exact(cov: np.ndarray | None) -> bool:
    return cov is None or bool(np.diag(cov).max() <= EXACT**2)


def _small(sigma: np.ndarray | None) -> bool:
    return sigma is None or bool(np.max(sigma) <= EXACT)


class _Pieces:
    """Stretches of time, in order. clocks: of cameras that are late [s], and the standard deviations; taken off."""

    def __init__(self, detections: Iterable[Detection], clocks: dict[str, tuple[float, float]] | None = None) -> None:
        self.clocks: dict[str, tuple[float, float]] = clocks or {}
        self._source = iter(detections)
        self._waiting: list[Detection] = []

    def take(self) -> list[Detection]:
        """The next one, empty at the end."""
        first = min((d.t for d in self._waiting), default=np.inf)
        newest = max((d.t for d in self._waiting), default=-np.inf)
        for detection in self._source:
            d = self._in_time(detection)
            first, newest = min(first, d.t), max(newest, d.t)
            self._waiting.append(d)
            if newest > first + PIECE + LATE:
                break
        if newest <= first + PIECE + LATE:
            piece, self._waiting = self._waiting, []
            return piece
        t = np.unique([d.t for d in self._waiting if first + PIECE - BORDER < d.t <= first + PIECE])
        gap = int(np.argmax(np.diff(t))) if len(t) > 1 else -1
        border = 0.5 * (t[gap] + t[gap + 1]) if gap >= 0 else first + PIECE
        piece = [d for d in self._waiting if d.t <= border]
        self._waiting = [d for d in self._waiting if d.t > border]
        return piece

    def put_back(self, piece: list[Detection]) -> None:
        """Take a piece back, and take the clocks' offsets, now known, off all that waits."""
        self._waiting = [self._in_time(d) for d in (*piece, *self._waiting)]

    def _in_time(self, d: Detection) -> Detection:
        late = self.clocks.get(d.camera)
        return d if late is None else replace(d, t=d.t - late[0])


class _Tracks:
    """Tracks by body that go on from piece to piece: signs of quaternions and turns of joints too."""

    def __init__(self, keep: Callable[[str, PoseTrack], None] | None) -> None:
        self._parts: dict[str, list[PoseTrack]] = {}
        self._last: dict[str, np.ndarray] = {}
        self._keep = keep or (lambda body, part: self._parts.setdefault(body, []).append(part))

    def go_on(self, tracks: dict[str, PoseTrack]) -> None:
        """Take the next piece's."""
        for body, part in tracks.items():
            if body in self._last:
                q = np.concatenate([self._last[body], part.q])
                q[:, 3:7] = quat_continuous(q[:, 3:7])
                q[:, 7:] = np.unwrap(q[:, 7:], axis=0)
                part = replace(part, q=q[1:])
            self._last[body] = part.q[-1:].copy()
            self._keep(body, part)

    def whole(self) -> dict[str, PoseTrack]:
        """All of them; none where another keeps them."""
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
    clocks: dict[str, tuple[float, float]],
    n_failed: int,
) -> Tracked:
    """One after another, and what is static as `statics` has it. Pieces without any pose are counted as such."""
    frames = Frames(
        *(np.concatenate([getattr(d.frames, field) for d in done]) for field in ("t", "camera", "rms", "tags"))
    )
    report = _one_report([d.report for d in done], statics.report, frames, [camera.name for camera in statics.cameras])
    report = replace(report, clocks=clocks)
    if n_failed:
        report.dropped_tags[f"in {n_failed} stretches of {PIECE:g} s without a pose"] = n_failed
    return Tracked(tracks, statics.cameras, statics.layout, frames, report)


def _one_report(
    reports: Sequence[TrackReport], found: TrackReport, frames: Frames, cameras: Sequence[str]
) -> TrackReport:
    """Sums and worst cases; a tag's reprojection is the mean over pieces, weighted by their poses.

    found: says what is static, and what was suspect where that was found.
    """

    def rms(own: np.ndarray) -> float:
        return float(np.sqrt(np.average(frames.rms[own] ** 2, weights=frames.tags[own])))

    seen = [c for c in range(len(cameras)) if (frames.tags[frames.camera == c] > 0).any()]
    tags = sorted({tag_id for report in reports for tag_id in report.rms_by_tag})
    squares: dict[int, list[tuple[float, int]]] = {tag_id: [] for tag_id in tags}
    dropped_steps: Counter[str] = Counter()
    dropped_tags: Counter[str] = Counter()
    suspects: dict[tuple[str, str], Suspect] = {}
    for suspect in (suspect for report in (found, *reports) for suspect in report.suspects):
        suspects.setdefault((suspect.kind, suspect.name), suspect)
    for report in reports:
        for tag_id, value in report.rms_by_tag.items():
            squares[tag_id].append((value**2, max(report.n_poses, 1)))
        dropped_steps.update(report.dropped_steps)
        dropped_tags.update(report.dropped_tags)
    unplaced = [name for name in reports[0].unplaced if all(name in report.unplaced for report in reports)]
    worst = sorted((row for report in reports for row in report.worst_frames), key=lambda row: -row[2])[:10]
    whole = rms(frames.tags > 0)
    return replace(
        found,
        n_steps=sum(report.n_steps for report in reports),
        n_poses=sum(report.n_poses for report in reports),
        rms=whole,
        rms_axis=whole / 2**0.5,
        rms_by_camera={cameras[c]: rms(frames.camera == c) for c in seen},
        rms_by_tag={
            tag_id: float(np.sqrt(np.average([value for value, _ in pairs], weights=[n for _, n in pairs])))
            for tag_id, pairs in squares.items()
        },
        noise_scale=float(np.median([report.noise_scale for report in reports])),
        dropped_steps=dict(dropped_steps),
        dropped_tags=dict(dropped_tags),
        worst_frames=worst,
        unplaced=unplaced,
        suspects=list(suspects.values()),
        spread=reports[0].spread,
        rms_bare=reports[0].rms_bare,
    )
