"""Imported poses before they become tosses: read, joined by a hinge, and levelled where no object is stated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tossid.errors import ConfigError
from tossid.motion.contact import Touch
from tossid.motion.hinge import find_hinge, hinged_tracks
from tossid.motion.hull_ground import level_by_hull
from tossid.motion.release import release_frames
from tossid.motion.sessions.lost_frames import LostFrames, find_lost_frames, lost_words
from tossid.objects import GRAVITY, ObjectModel, unstated_object
from tossid.settings.ingestion import IngestSettings
from tossid.store.importers.registry import FORMATS, InputFormat
from tossid.types import OnDemand, PoseTrack
from tossid.vision.progress import Reporter


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
    tracks, rate_hz = entry.read(source, model)
    return ImportedPoses(model, tracks, rate_hz)


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
    """
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
    found = find_lost_frames(tracks, model, gravity=settings.gravity, settings=settings.losses)
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
