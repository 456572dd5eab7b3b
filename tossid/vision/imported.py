"""Imported poses before they become tosses: read, joined by a hinge, and levelled where no object is stated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tossid.errors import ConfigError, FileError
from tossid.motion.contact import Touch
from tossid.motion.hinge import find_hinge, hinged_tracks
from tossid.motion.hull_ground import level_by_hull
from tossid.motion.release import release_frames
from tossid.motion.resting import other_order, rest_heights, resting_pose
from tossid.motion.sessions.levelling import IDENTITY, turned_track
from tossid.motion.sessions.lost_frames import LostFrames, find_lost_frames, lost_words
from tossid.objects import GRAVITY, ObjectModel, unstated_object
from tossid.settings.ingestion import IngestSettings
from tossid.store.importers.checks import KEPT
from tossid.store.importers.registry import FORMATS, Imported, InputFormat
from tossid.types import OnDemand, PoseTrack
from tossid.vision.progress import Reporter

FAR_GROUND = 0.2
"""Height of the tracked point at rest beyond which an object of unknown shape does not show its ground [m]."""


@dataclass(frozen=True)
class ImportedPoses:
    """What an importer read, as tracks of one object."""

    model: ObjectModel
    """the object; of two links of which nothing is stated, their hinge"""
    tracks: Sequence[PoseTrack]
    """one track a toss"""
    rate_hz: float | None = None
    """frames a second; None: the median over the tracks"""
    facts: dict[str, float] = field(default_factory=dict)
    """what was found on the way, for the dataset's provenance"""


def read_poses(source: Any, entry: InputFormat, model: ObjectModel, report: Reporter) -> ImportedPoses:
    """The tracks of an object.

    Args:
        source: Settings of the format.
        entry: The format.
        model: The object.
        report: Takes progress.
    """
    report.message("import", f"{source.path}: reading tosses of '{model.name}'")
    read = entry.read(source, model)
    for remark in read.remarks:
        report.problem("import", f"{source.path}: {remark}")
    _check_order(read, model, source, report)
    return ImportedPoses(model, read.tracks, read.rate_hz)


def _check_order(read: Imported, model: ObjectModel, source: Any, report: Reporter) -> None:
    """Say, or refuse where nobody states it, an order of quaternions that the places of rest refute."""
    found = other_order(read.tracks, model, w_first=read.w_first)
    if found is None:
        return
    said = (
        f"quaternions look like {found.name}: read so, {found.flat} of {found.rests} tosses come to rest on a face, "
        f"and {found.as_read} as they were read"
    )
    if read.stated:
        report.problem("import", f"{source.path}: {said}; they are kept in the order that the source states")
        return
    names = f"timestamp tx ty tz {found.name}"
    raise FileError(source.path, f"{said}; source.columns='{names}', or a first line '# {names}', says so")


def on_ground(read: ImportedPoses, path: Path, settings: IngestSettings, report: Reporter) -> ImportedPoses:
    """Poses over the ground z = 0: of a stated object by where it rests, of an unknown one by its hull.

    Args:
        read: As recorded.
        path: Where they come from.
        settings: Whether the world is levelled.
        report: Takes the remark that the ground is off.
    """
    if read.model.is_stated:
        return grounded(read, path, settings, report)
    return replace(read, tracks=levelled(read.tracks, read.model, path, settings, report))


def grounded(read: ImportedPoses, path: Path, settings: IngestSettings, report: Reporter) -> ImportedPoses:
    """Poses of a stated object over the ground z = 0, where it comes to rest at another height.

    Args:
        read: As recorded.
        path: Where they come from.
        settings: Whether the world is levelled, and from which height on.
        report: Takes the remark that the ground is off.

    Returns:
        The poses, raised or lowered; as they are where the ground is z = 0, `level=never`, or tosses do not agree.
    """
    heights = rest_heights(read.tracks, read.model)
    if not len(heights):
        return read
    ground = float(np.median(heights))
    agree = int(np.sum(np.abs(heights - ground) < settings.level_height))
    if abs(ground) < settings.level_height:
        return read
    found = f"{path}: tosses come to rest {1e3 * ground:.0f} mm {'above' if ground > 0 else 'below'} z = 0 (median)"
    if settings.level == "never" or agree <= len(heights) / 2:
        why = "as level=never asks" if settings.level == "never" else f"since only {agree} of {len(heights)} agree"
        report.problem("level", f"{found}; left as it is, {why}")
        return read
    report.problem(
        "level", f"{found}, as {agree} of {len(heights)} agree; the world is shifted so that the ground is z = 0"
    )
    tracks = read.tracks
    shifted = OnDemand(lambda i: turned_track(tracks[i], IDENTITY, -ground), len(tracks), kept=KEPT)
    return replace(read, tracks=shifted, facts={**read.facts, "ground_height_m": ground})


def read_links(source: Any, entry: InputFormat, report: Reporter) -> ImportedPoses:
    """The tracks of two links of which nothing is stated, with the hinge that they show.

    Args:
        source: Settings of the format.
        entry: The format.
        report: Takes progress.

    Raises:
        ConfigError: The format does not give the poses of two links.
        InputError: The joint never moves, or is no hinge.
    """
    if entry.read_links is None:
        able = ", ".join(f"source={name}" for name, other in FORMATS.items() if other.read_links is not None)
        raise ConfigError(
            "object.links",
            f"source={entry.name} does not give the poses of a second link; expected {able}. A recording of one "
            "link and a joint's angle needs an object that states the hinge; `tossid train object=unknown "
            "object.links=2` then learns the rest",
        )
    report.message("import", f"{source.path}: reading tosses of two links")
    first, second = entry.read_links(source)
    found = find_hinge(first, second)
    angle, tilt, offset = np.rad2deg(found.spread), np.rad2deg(found.tilt), 1e3 * found.offset
    report.message(
        "hinge",
        f"{source.path}: the links are on a hinge, whose angle varies by {angle:.0f}° (standard deviation); between "
        f"the links, its axis is off by {tilt:.2f}° and its point by {offset:.2f} mm (rms)",
    )
    facts = {"hinge_spread_rad": found.spread, "hinge_tilt_rad": found.tilt, "hinge_offset_m": found.offset}
    return ImportedPoses(unstated_object(hinge=found.hinge), hinged_tracks(first, second, found), None, facts)


def levelled(
    tracks: Sequence[PoseTrack], model: ObjectModel, path: Path, settings: IngestSettings, report: Reporter
) -> Sequence[PoseTrack]:
    """Tracks of an unknown object over the ground z = 0; `level=never` leaves them as they are.

    Args:
        tracks: Of the object.
        model: One rigid body, or two links on a hinge, of which nothing else is stated.
        path: Where they come from.
        settings: Whether the world is levelled.
        report: Takes the remark that the ground is off.

    Raises:
        FileError: The ground is too far from z = 0 to be found.
    """
    poses = [pose for pose in map(resting_pose, tracks) if pose is not None]
    high = float(np.median([pose[2] for pose in poses])) if poses else 0.0
    if abs(high) > FAR_GROUND and settings.level != "never":
        said = f"tosses come to rest with the tracked point {abs(high):.2f} m {'above' if high > 0 else 'below'} z = 0"
        problem = (
            "an object of unknown shape shows the ground only where it is near z = 0 (level=never takes it as it is)"
        )
        raise FileError(path, f"{said}; {problem}")
    found_tracks, ground = level_by_hull(tracks, tree=model)
    if ground is None:
        return tracks
    slope = np.rad2deg(np.arctan(np.linalg.norm(ground[1:])))
    found = f"{path}: with the object's hull, the ground is {1e3 * ground[0]:.1f} mm high and slopes by {slope:.2f}°"
    if settings.level == "never":
        report.problem("level", f"{found}; left as it is, as level=never asks")
        return tracks
    report.problem("level", f"{found}; the world is turned and shifted so that it is z = 0 (level=never leaves it)")
    return found_tracks


def lost_frames(
    tracks: Sequence[PoseTrack], model: ObjectModel, path: Path, settings: IngestSettings, report: Reporter
) -> LostFrames | None:
    """Frames that were lost at impacts; reports these.

    Args:
        tracks: As recorded.
        model: The object.
        path: Where they come from.
        settings: `lost` says whether times are to be mended.
        report: Takes findings and problems.

    Returns:
        What was lost; None for objects with joints, or of which nothing is stated.
    """
    if model.n_joints or not model.is_stated:
        return None
    found = find_lost_frames(tracks, model, gravity=settings.gravity)
    said = lost_words(found)
    if said is not None and settings.lost == "keep":
        report.problem("import", f"{path}: {said}; kept so (lost=undo mends the times)")
    elif said is not None:
        aside = f"{len(found.unjudged)} of {len(tracks)} tosses have such an impact that cannot be judged, and no split"
        report.problem("import", f"{path}: {said}; times are mended, as lost=undo asks; {aside}")
    return found


def from_release(
    tracks: Sequence[PoseTrack],
    model: ObjectModel,
    *,
    touch: Touch | None = None,
    gravity: float = GRAVITY,
    report: Reporter | None = None,
) -> tuple[Sequence[PoseTrack], str]:
    """Ready tosses without first frames in which a hand still moves the object.

    Args:
        tracks: One a toss, as recorded.
        model: The object.
        touch: Where it may touch the ground, of an object without corners.
        gravity: [m/s²].
        report: Takes a problem where frames are left out.

    Returns:
        The tracks, and how many frames are left out of which, in words.
    """
    first = release_frames(tracks, model, gravity=gravity, touch=touch)
    if not first.any():
        return tracks, ""
    held = {tracks[i].name: int(first[i]) for i in np.flatnonzero(first).tolist()}
    some = f"{len(held)} of {len(tracks)} tosses begin before the release"
    (report or Reporter()).problem("import", f"{some}: {first.sum()} frames in which a hand moves them are left out")
    words = "; ".join(f"{name}: {count}" for name, count in held.items())
    return OnDemand(lambda i: tracks[i].frames(slice(int(first[i]), None)), len(tracks), kept=64), words
