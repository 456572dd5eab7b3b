"""From whatever was recorded to a dataset of tosses: the verb `tossid.ingest`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from tossid.errors import ConfigError, FileError
from tossid.motion import Defect, covariance_source, find_defects, median_rate, tosses_in_turn
from tossid.motion.defects import RULES
from tossid.motion.free_fall import find_parabola
from tossid.motion.segmentation import Stretch
from tossid.motion.sessions import as_recorded
from tossid.motion.sessions.copies import Copy, copy_words, find_copies
from tossid.motion.sessions.falls import WHITE, look_for_smoothing
from tossid.motion.sessions.lost_frames import LostFrames
from tossid.objects import ObjectModel, load_object, recorded_object
from tossid.settings.changed import changed
from tossid.settings.ingestion import IngestSettings, TossSettings
from tossid.settings.objects import ObjectSettings, UnknownObjectSettings
from tossid.store import Dataset, drawn_splits, source_sha256
from tossid.store.importers.registry import Contents, InputFormat
from tossid.store.provenance import provenance_of
from tossid.types import LongTrack, PoseTrack
from tossid.vision import stages
from tossid.vision.dataset_output import DatasetOutput, dataset_output
from tossid.vision.imported import ImportedPoses, from_release, lost_frames, on_ground, read_links, read_poses
from tossid.vision.pose_graph.report import TrackReport
from tossid.vision.progress import Progress, Reporter
from tossid.vision.recordings.disk_buffer import pose_spool
from tossid.vision.recordings.registry import Opened, format_named, input_formats, open_recording, recognized_format
from tossid.vision.setup.layout import object_tags

Named = str | Path | ObjectSettings | UnknownObjectSettings | ObjectModel
"""How an object is named: by a known name, a file, settings, or a model."""
Scalars = Mapping[str, str | int | float | bool]

DEFAULT = IngestSettings()


@dataclass(frozen=True)
class IngestReport:
    """What became of a source on its way to a dataset."""

    detect: Mapping[str, int] = field(default_factory=dict)
    """tags found and rejected, by reason"""
    track: TrackReport | None = None
    """what became of the detections; None for imported poses"""
    ground: stages.Levelled | None = None
    """the ground that was found; None where the poses do not tell it"""
    rejected: tuple[Stretch, ...] | None = None
    """stretches of the recording that are no toss, and why; None where the source is ready tosses"""
    defects: tuple[Defect, ...] = ()
    """imported tosses that break a rule of motion"""
    lost: LostFrames | None = None
    """frames that imported tosses lost at impacts; None where that is not looked for"""
    problems: tuple[str, ...] = ()
    """messages that a person should not miss"""


@dataclass(frozen=True)
class Ingested:
    """A dataset, and the report of how it was made."""

    dataset: Dataset
    """the tosses: in memory, or read from the file that was written when they are asked for"""
    report: IngestReport
    """what became of the source"""


def ingest(
    path: str | Path,
    *,
    object: Named | None = None,
    source: str | None = None,
    settings: IngestSettings = DEFAULT,
    out: str | Path | None = None,
    progress: Callable[[Progress], None] | None = None,
    **keys: Any,
) -> Dataset:
    """The tosses of a recording, of tracked poses, or of ready tosses.

    A recording is searched for tags, its object tracked and its tosses segmented; of long films only stretches are in
    memory at a time. Everything gets velocities, covariances and phases.

    Args:
        path: What was recorded: a folder of frames or videos, a bag, a folder of TUM files or of `.pt` tensors.
        object: What was tossed: a known name ("cube"), an MJCF or URDF file, or a model. None: what the recording
            says, else the cube (the elbow for `source="pll"`). "unknown": the dataset states none, and phases come
            from motion alone; of tracked poses of one rigid body. `UnknownObjectSettings(links=2)`: of two links on a
            hinge, whose poses are tracked each.
        source: Format of the input, a name of `tossid.vision.recordings.registry.input_formats()`. None: what the
            path looks like.
        settings: How it is done.
        out: Dataset file (.h5) to write; the result then reads from it. None: the result is in memory.
        progress: Called with a `Progress` now and then. None: problems become Python warnings.
        **keys: Fields of `settings` or of the source's own settings by name: `gravity=9.82`, `rate_hz=120.0`.

    Returns:
        The dataset; its provenance says what it was made from.

    Raises:
        ConfigError: No format or setting has the name.
        FileError: The source is missing or damaged.
        InputError: It holds no tag, no pose or no toss.
    """
    path = Path(path)
    entry = format_named(source) if source is not None else recognized_format(path)
    if entry is None:
        problem = "no such file or folder" if not path.exists() else "holds no input that is recognized"
        raise FileError(path, f"{problem}; expected one of {', '.join(input_formats())} (source=NAME says which)")
    own = {name for name in (f.name for f in fields(entry.settings)) if name not in ("name", "path")}
    chosen = entry.settings(path=path, **{name: value for name, value in keys.items() if name in own})
    settings = changed(settings, {name: value for name, value in keys.items() if name not in own})
    out = None if out is None else Path(out)
    return ingest_source(chosen, object=object, settings=settings, out=out, progress=progress).dataset


def ingest_source(
    source: Any,
    *,
    object: Named | None = None,
    settings: IngestSettings = DEFAULT,
    out: Path | None = None,
    progress: Callable[[Progress], None] | None = None,
    provenance: Scalars | None = None,
) -> Ingested:
    """`ingest` of a source with its own settings, with a report.

    Args:
        source: Settings of a registered format, such as `TumSource(path=...)`.
        object: As `ingest` has it.
        settings: As `ingest` has it.
        out: As `ingest` has it.
        progress: As `ingest` has it.
        provenance: What the dataset says about the call that made it; None: this function and its settings.

    Returns:
        The dataset and the report.

    Raises:
        FileError: The source is missing or damaged.
        InputError: It holds no tag, no pose or no toss.
    """
    entry, report = format_named(source.name), Reporter(progress)
    if provenance is None:
        provenance = provenance_of("tossid.ingest", settings)
    opened = None
    if entry.contents is Contents.RECORDING:
        opened = with_object(open_recording(source), object, default=entry.default_object)
    with dataset_output(out) as output:
        if opened is not None:
            made = _ingest_recording(opened, entry.name, settings, output, provenance, report)
        else:
            if not source.path.exists():
                raise FileError(source.path, "no such file or folder; source.path names where the tosses lie")
            if isinstance(object, UnknownObjectSettings) and object.links > 1:
                read = read_links(source, entry, report)
            else:
                model = _model(object) or _model(entry.default_object)
                assert model is not None
                read = read_poses(source, entry, model, report)
            made = _import_poses(source, entry, read, settings, output, provenance, report)
    return Ingested(output.dataset(out), made)


def with_object(opened: Opened, object: Named | None, *, default: str | None = None) -> Opened:
    """A recording with its object, which gets the tags that the recording's layout gives it.

    Args:
        opened: The recording.
        object: A name, a file or a model; None: what the recording's `object.yaml` says, else `default`.
        default: The name of an object, or None for none.

    Returns:
        The recording, without an object where none is named.

    Raises:
        ObjectError: The layout has no tag of known pose on the object.
    """
    model = _model(object, opened.folder) or _model(default)
    if model is None:
        return opened
    if not model.is_stated:
        raise ConfigError(
            "object",
            "unknown is for tracked poses (source=tum, contactnets, pll); tracking images needs the object's tags",
        )
    return replace(opened, model=replace(model, tags=object_tags(opened.layout, model.body_names)))


def dataset_of_poses(
    opened: Opened,
    poses: PoseTrack | LongTrack,
    *,
    settings: TossSettings = DEFAULT,
    out: Path | None = None,
    lineage: Scalars | None = None,
    report: Reporter | None = None,
) -> Ingested:
    """The dataset of an object's tracked poses: levelled, segmented, smoothed, written toss by toss.

    Args:
        opened: The recording with its object.
        poses: The object's track.
        settings: How tosses are found.
        out: Dataset file (.h5) to write; None: the dataset is in memory.
        lineage: What the dataset's provenance says beside the origin of its covariances.
        report: Takes progress and problems.

    Returns:
        The dataset and the report.

    Raises:
        InputError: There is no toss in it.
    """
    with dataset_output(out) as output:
        made = _segment_poses(opened, poses, "frames", settings, output, lineage or {}, report or Reporter())
    return Ingested(output.dataset(out), made)


def _ingest_recording(
    opened: Opened, source: str, settings: IngestSettings, output: DatasetOutput, provenance: Scalars, report: Reporter
) -> IngestReport:
    """Detect, track and segment; poses go to a temporary file, so that a long film needs little memory."""
    body, tally = stages.object_name(opened), Counter[str]()
    with pose_spool(output.folder) as spool:

        def keep(name: str, part: PoseTrack) -> None:
            if name == body:
                spool.add(part)

        found = stages.detect(opened, settings=settings.detect, threads=settings.threads, tally=tally, report=report)
        tracked = stages.track(
            opened, found, settings=settings.track, spool_folder=output.folder, keep=keep, report=report
        )
        poses = spool.track()
        if poses is None:
            raise stages.too_few_poses(opened, body)
        lineage = {
            **provenance,
            "source_path": str(opened.path),
            "source_sha256": source_sha256(opened.path),
            "n_images": opened.recording.n_frames if opened.recording is not None else 0,
            "n_detections": int(tally["tags"]),
            "n_poses": tracked.report.n_poses,
            "reprojection_rms_px": tracked.report.rms,
        }
        made = _segment_poses(opened, poses, source, settings, output, lineage, report)
    return replace(made, detect=stages.counts(tally), track=tracked.report)


def _segment_poses(
    opened: Opened,
    poses: PoseTrack | LongTrack,
    source: str,
    settings: TossSettings,
    output: DatasetOutput,
    lineage: Scalars,
    report: Reporter,
) -> IngestReport:
    """Level, segment and smooth; tosses are written one by one."""
    model = opened.object()
    poses, ground = stages.level(opened, poses, settings=settings, report=report)
    tracks, rejected = stages.segment_tosses(opened, poses, settings=settings, report=report)
    tracks, order = stages.sessions(tracks, model, settings=settings, report=report)
    with output.sink(model) as sink:
        for toss in tosses_in_turn(tracks, model, gravity=settings.gravity):
            sink.add(toss)
        sink.finish(
            rate_hz=median_rate(tracks),
            source=source,
            provenance={**lineage, "covariance_source": covariance_source(tracks)},
            splits=drawn_splits([track.name for track in tracks], fractions=settings.splits, seed=settings.seed),
            order=order,
        )
    return IngestReport(ground=ground, rejected=tuple(rejected), problems=tuple(report.problems))


def _import_poses(
    source: Any,
    entry: InputFormat,
    read: ImportedPoses,
    settings: IngestSettings,
    output: DatasetOutput,
    provenance: Scalars,
    report: Reporter,
) -> IngestReport:
    """Give tracks or ready tosses velocities, covariances and phases, and look for defects."""
    path, model, tracks = source.path, read.model, read.tracks
    names: list[str] = []
    defects: list[Defect] = []
    with output.sink(model) as sink:
        report.message("import", f"{path}: {len(tracks)} tosses, {sum(len(track.t) for track in tracks)} frames")
        read = on_ground(read, path, settings, report)
        tracks = read.tracks
        lost = lost_frames(tracks, model, path, settings, report)
        mended = lost if settings.lost == "undo" else None
        tracks = tracks if mended is None else mended.mended(tracks)
        parabola = None if model.is_stated else find_parabola(tracks, model, gravity=settings.gravity)
        flying, touch = (model, None) if parabola is None else (parabola.body(), parabola.may_touch)
        _check_measured(tracks, flying, path, settings, report)
        tracks, held = from_release(tracks, flying, touch=touch, gravity=settings.gravity, report=report)
        order, copies = None, find_copies(tracks)
        if model.is_stated:
            turns = stages.turned_back(tracks, model, settings=settings, report=report)
            tracks = tracks if turns is None else turns.undone(tracks)
            tracks, order = stages.sessions(tracks, model, settings=settings, report=report)
            order = order if turns is None else turns.with_order(order)
        advance = report.counter("velocities and phases", len(tracks), "tosses")
        for toss in tosses_in_turn(tracks, model, gravity=settings.gravity, end_at_rest=entry.cut_at_rest):
            sink.add(toss)
            names.append(toss.name)
            # of what was recorded: levelling changes neither defects nor, with them, the draw of splits
            defects += find_defects([as_recorded(toss, order)], flying, gravity=settings.gravity)
            advance(1)
        set_aside = _set_aside(defects, len(tracks), settings, report)
        kept = [name for name in names if name not in set_aside]
        sink.finish(
            rate_hz=read.rate_hz or median_rate(tracks),
            source=entry.name,
            provenance={
                **provenance,
                **read.facts,
                "source_path": str(path),
                "source_sha256": source_sha256(path),
                "covariance_source": covariance_source(tracks),
                "defects": "; ".join(f"{d.toss}: {d.rule} {d.value:.1f}" for d in defects),
                **({} if mended is None else {"lost_frames": mended.facts()}),
                **({"held_frames": held} if held else {}),
            },
            splits=_splits(kept, copies, frozenset() if mended is None else mended.unjudged, settings, report),
            order=order,
        )
    return IngestReport(defects=tuple(defects), lost=lost, problems=tuple(report.problems))


def _check_measured(
    tracks: Sequence[PoseTrack], model: ObjectModel, path: Path, settings: IngestSettings, report: Reporter
) -> None:
    """Refuse imported tosses that a smoother made (`settings.smoothed`); report those that do not fall by gravity."""
    seen = look_for_smoothing(tracks, model, gravity=settings.gravity)
    if seen.falls:
        return
    gravity, off = f"{settings.gravity:g} m/s²", f"{seen.fall_error:.1f} m/s²"
    unlike = f"they do not fall by gravity: where nearest to it ({gravity}), tosses are off by {off} in the median"
    if not seen.smoothed:
        report.problem("import", f"{path}: {unlike} of {seen.n_falls}; is gravity={settings.gravity:g} right?")
        return
    smooth = f"fourth over third differences of positions are {seen.roughness:.2f}, and {WHITE:.2f} in white noise"
    problem = f"the poses are a smoother's, not measured: {unlike} of {seen.n_falls}; {smooth}"
    if settings.smoothed == "refuse":
        raise FileError(path, f"{problem}. Nothing can be learned from them (smoothed=keep ingests them nevertheless)")
    report.problem("import", f"{path}: {problem}; kept as smoothed=keep asks")


def _set_aside(defects: list[Defect], n_tosses: int, settings: IngestSettings, report: Reporter) -> set[str]:
    """The tosses that get no split; reports which rules how many tosses break."""
    names = {defect.toss for defect in defects}
    if not names:
        return names
    broken = Counter(defect.rule for defect in defects)
    by_rule = ", ".join(f"{rule} {broken[rule]}" for rule in RULES if broken[rule])
    is_aside = settings.defects == "set_aside"
    done = "left out of the splits" if is_aside else "kept; defects=set_aside leaves them out"
    report.problem("import", f"{len(names)} of {n_tosses} tosses have defects ({by_rule}): {done}")
    return names if is_aside else set()


def _splits(
    names: Sequence[str],
    copies: tuple[Copy, ...],
    unjudged: frozenset[str],
    settings: IngestSettings,
    report: Reporter,
) -> dict[str, str]:
    """The splits of tosses of which some may be copies; reports these. Those that are left out change no other's."""
    of = {copy.name: copy.of for copy in copies}
    splits = drawn_splits(names, fractions=settings.splits, seed=settings.seed, copies=of)
    said, is_aside = copy_words(copies), settings.copies == "set_aside"
    if said is not None:
        done = "left out of the splits" if is_aside else "kept, each in the split of its first"
        report.problem("import", f"{said}: {done}")
    left_out = unjudged | (set(of) if is_aside else set())
    return {name: split for name, split in splits.items() if name not in left_out}


def _model(object: Named | None, folder: Path | None = None) -> ObjectModel | None:
    """The object that is meant: as named, else as a recording's folder says, else none."""
    if object is None and folder is not None:
        recorded = recorded_object(folder)
        object = None if recorded is None else replace(recorded, tags=None)  # its tags come from the layout
    return None if object is None else load_object(object)
