"""From whatever was recorded to a dataset of tosses: the verb `tossid.ingest`."""

from __future__ import annotations

import tempfile
import weakref
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from tossid.errors import ConfigError, FileError
from tossid.ingestion import stages
from tossid.ingestion.progress import Progress, Reporter
from tossid.ingestion.tracked_poses import ImportedPoses, import_poses, read_links, read_poses
from tossid.motion import Defect, covariance_source, median_rate, tosses_in_turn
from tossid.motion.segmentation import Stretch
from tossid.objects import ObjectModel, load_object, recorded_object
from tossid.outputs import output_file
from tossid.settings.changed import changed
from tossid.settings.ingestion import IngestSettings, TossSettings
from tossid.settings.objects import ObjectSettings, UnknownObjectSettings
from tossid.store import Dataset, dataset_writer, drawn_splits, open_dataset, read_dataset, source_sha256
from tossid.store.importers.registry import Contents
from tossid.store.provenance import provenance_of
from tossid.types import LongTrack, PoseTrack
from tossid.vision.pose_graph.report import TrackReport
from tossid.vision.recordings.disk_buffer import PoseSpool
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

    Raises:
        FileError: The source is missing or damaged.
        InputError: It holds no tag, no pose or no toss.
    """
    entry, report = format_named(source.name), Reporter(progress)
    provenance = provenance_of("tossid.ingest", settings) if provenance is None else provenance
    if entry.contents is Contents.RECORDING:
        opened = with_object(open_recording(source), object, default=entry.default_object)
        with _dataset_file(out) as (file, finished):
            made = _ingest_recording(opened, entry.name, settings, file, provenance, report)
        return Ingested(finished[0], made)
    if not source.path.exists():
        raise FileError(source.path, "no such file or folder; source.path names where the tosses lie")
    with _dataset_file(out) as (file, finished):
        if isinstance(object, UnknownObjectSettings) and object.links > 1:
            read = read_links(source, entry, report)
        else:
            model = _model(object) or _model(entry.default_object)
            assert model is not None
            read = read_poses(source, entry, model, report)
        made = _ingest_poses(source.path, entry.name, read, settings, file, provenance, report, entry.cut_at_rest)
    return Ingested(finished[0], made)


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

    Raises:
        InputError: There is no toss in it.
    """
    with _dataset_file(out) as (file, finished):
        made = _segment_poses(opened, poses, "frames", settings, file, lineage or {}, report or Reporter())
    return Ingested(finished[0], made)


@contextmanager
def _dataset_file(out: Path | None) -> Iterator[tuple[Path, list[Dataset]]]:
    """A file to write a dataset to, and a list that holds the dataset after the block.

    `out` appears whole when the block ends, or not at all, and its tosses are read from it when they are asked for.
    None: the dataset is in memory.
    """
    finished: list[Dataset] = []
    if out is None:
        with tempfile.TemporaryDirectory(prefix="tossid-ingest-") as folder:
            file = Path(folder) / "tosses.h5"
            yield file, finished
            finished.append(read_dataset(file))
        return
    with output_file(out) as file:
        yield file, finished
    stack = ExitStack()
    finished.append(stack.enter_context(open_dataset(out)))
    weakref.finalize(finished[0].tosses, stack.close)  # the file is closed when the tosses are no longer used


def _ingest_recording(
    opened: Opened, source: str, settings: IngestSettings, file: Path, provenance: Scalars, report: Reporter
) -> IngestReport:
    """Detect, track and segment; poses go to a temporary file, so that a long film needs little memory."""
    body, tally = stages.object_name(opened), Counter[str]()
    with tempfile.TemporaryFile(dir=file.parent) as buffer:
        spool = PoseSpool(buffer)

        def keep(name: str, part: PoseTrack) -> None:
            if name == body:
                spool.add(part)

        found = stages.detect(opened, settings=settings.detect, threads=settings.threads, tally=tally, report=report)
        tracked = stages.track(
            opened, found, settings=settings.track, spool_folder=file.parent, keep=keep, report=report
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
        made = _segment_poses(opened, poses, source, settings, file, lineage, report)
    return replace(made, detect=stages.counts(tally), track=tracked.report)


def _segment_poses(
    opened: Opened,
    poses: PoseTrack | LongTrack,
    source: str,
    settings: TossSettings,
    file: Path,
    lineage: Scalars,
    report: Reporter,
) -> IngestReport:
    """Level, segment and smooth; tosses are written one by one."""
    model = opened.object()
    poses, ground = stages.level(opened, poses, settings=settings, report=report)
    tracks, rejected = stages.segment_tosses(opened, poses, settings=settings, report=report)
    tracks, order = stages.sessions(tracks, model, settings=settings, report=report)
    with dataset_writer(model, file) as writer:
        for toss in tosses_in_turn(tracks, model, gravity=settings.gravity):
            writer.add(toss)
        writer.finish(
            rate_hz=median_rate(tracks),
            source=source,
            provenance={**lineage, "covariance_source": covariance_source(tracks)},
            splits=drawn_splits([track.name for track in tracks], fractions=settings.splits, seed=settings.seed),
            order=order,
        )
    return IngestReport(ground=ground, rejected=tuple(rejected), problems=tuple(report.problems))


def _ingest_poses(
    path: Path,
    source: str,
    read: ImportedPoses,
    settings: IngestSettings,
    file: Path,
    provenance: Scalars,
    report: Reporter,
    end_at_rest: bool,
) -> IngestReport:
    """Give imported tracks or ready tosses velocities, covariances and phases; tosses are written one by one."""
    report.message("import", f"{path}: {len(read.tracks)} tosses, {sum(len(track.t) for track in read.tracks)} frames")
    checked = import_poses(read, path, settings, report)
    tracks, names = checked.tracks, list[str]()
    advance = report.counter("velocities and phases", len(tracks), "tosses")
    with dataset_writer(read.model, file) as writer:
        for toss in tosses_in_turn(tracks, read.model, gravity=settings.gravity, end_at_rest=end_at_rest):
            writer.add(toss)
            names.append(toss.name)
            checked.look_for_defects(toss, settings)
            advance(1)
        writer.finish(
            rate_hz=read.rate_hz or median_rate(tracks),
            source=source,
            provenance={
                **provenance,
                **checked.facts,
                "source_path": str(path),
                "source_sha256": source_sha256(path),
                "covariance_source": covariance_source(tracks),
                "defects": "; ".join(f"{d.toss}: {d.rule} {d.value:.1f}" for d in checked.defects),
            },
            splits=checked.splits(names, settings, report),
            order=checked.order,
        )
    return IngestReport(defects=tuple(checked.defects), problems=tuple(report.problems))


def _model(object: Named | None, folder: Path | None = None) -> ObjectModel | None:
    """The object that is meant: as named, else as a recording's folder says, else none."""
    if object is None and folder is not None:
        recorded = recorded_object(folder)
        object = None if recorded is None else replace(recorded, tags=None)  # its tags come from the layout
    return None if object is None else load_object(object)
