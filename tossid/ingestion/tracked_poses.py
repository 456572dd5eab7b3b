"""Poses that others tracked, before they become tosses: read, checked, and brought over the ground."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tossid.errors import ConfigError, FileError
from tossid.ingestion import stages
from tossid.ingestion.progress import Reporter
from tossid.motion import Defect, find_defects
from tossid.motion.contact import Touch
from tossid.motion.defects import RULES
from tossid.motion.free_fall import find_parabola
from tossid.motion.hinge import find_hinge, hinged_tracks
from tossid.motion.hull_ground import level_by_hull
from tossid.motion.release import release_frames
from tossid.motion.resting import other_order, rest_heights, resting_pose
from tossid.motion.sessions import as_recorded
from tossid.motion.sessions.copies import Copy, copy_words, find_copies
from tossid.motion.sessions.levelling import IDENTITY, turned_track
from tossid.motion.sessions.witnesses import fall_words
from tossid.objects import ObjectModel, unstated_object
from tossid.settings.ingestion import IngestSettings
from tossid.store import drawn_splits
from tossid.store.importers.registry import FORMATS, Imported, InputFormat
from tossid.store.recorded_poses.checks import KEPT
from tossid.types import OnDemand, PoseTrack, RecordingOrder, Toss

LEVEL_HEIGHT = 0.01
"""Height of the ground above z = 0 from which on imported tosses are shifted [m]."""
AGREE = 0.8
"""Share of the tosses that have to agree on it: a body's frame that is off raises one face and lowers another."""
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
    """The tracks of an object."""
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


@dataclass
class CheckedPoses:
    """Tracks over the ground z = 0, from their release on, in the order of their sessions.

    Attributes:
        tracks: One a toss.
        flying: The body whose flight is judged: the object, or, of one that nobody states, what its flights show.
        order: Of recording, with its sessions; None of an object that nobody states.
        copies: Tosses that are earlier ones turned about the vertical.
        facts: What was found on the way, for the dataset's provenance.
        defects: What neither gravity nor contact explains, of the tosses that were looked at.
    """

    tracks: Sequence[PoseTrack]
    flying: ObjectModel
    order: RecordingOrder | None
    copies: tuple[Copy, ...]
    facts: dict[str, str | float]
    defects: list[Defect] = field(default_factory=list)

    def look_for_defects(self, toss: Toss, settings: IngestSettings) -> None:
        """Add a toss's defects, as it was recorded: levelling changes neither them nor, with them, the splits."""
        self.defects += find_defects([as_recorded(toss, self.order)], self.flying, gravity=settings.gravity)

    def splits(self, names: Sequence[str], settings: IngestSettings, report: Reporter) -> dict[str, str]:
        """The splits of all tosses but those that are left out, which change no other's; reports these.

        Args:
            names: Of the tosses, in order.
            settings: What is left out: tosses with defects, copies.
            report: Takes problems.
        """
        broken = {defect.toss for defect in self.defects}
        if broken:
            by_rule = Counter(defect.rule for defect in self.defects)
            rules = ", ".join(f"{rule} {by_rule[rule]}" for rule in RULES if by_rule[rule])
            aside = settings.defects == "set_aside"
            done = "left out of the splits" if aside else "kept; defects=set_aside leaves them out"
            report.problem("import", f"{len(broken)} of {len(names)} tosses have defects ({rules}): {done}")
            names = [name for name in names if not aside or name not in broken]
        of = {copy.name: copy.of for copy in self.copies}
        splits = drawn_splits(names, fractions=settings.splits, seed=settings.seed, copies=of)
        found, aside = copy_words(self.copies), settings.copies == "set_aside"
        if found is not None:
            done = "left out of the splits" if aside else "kept, each in the split of its first"
            report.problem("import", f"{found}: {done}")
        return {name: split for name, split in splits.items() if not aside or name not in of}


def import_poses(read: ImportedPoses, path: Path, settings: IngestSettings, report: Reporter) -> CheckedPoses:
    """Imported poses made ready to become tosses.

    Args:
        read: As recorded.
        path: Where they come from.
        settings: What is undone of what befell them: a ground elsewhere, turns about the vertical.
        report: Takes findings and problems.

    Raises:
        FileError: The ground is too far away to be found.
    """
    model, facts = read.model, dict[str, str | float](read.facts)
    if model.is_stated:
        tracks, height = _over_the_ground(read.tracks, model, path, settings, report)
        facts |= {} if height is None else {"ground_height_m": height}
    else:
        tracks = _levelled_by_hull(read.tracks, model, path, settings, report)
    parabola = None if model.is_stated else find_parabola(tracks, model, gravity=settings.gravity)
    flying, touch = (model, None) if parabola is None else (parabola.body(), parabola.may_touch)
    tracks, held = _from_release(tracks, flying, touch=touch, gravity=settings.gravity, report=report)
    facts |= {"held_frames": held} if held else {}
    order, copies = None, find_copies(tracks)
    if model.is_stated:
        said = fall_words(tracks, model, gravity=settings.gravity)
        if said is not None:
            report.problem("import", f"{path}: {said}")
        turns = stages.turned_back(tracks, model, settings=settings, report=report)
        tracks = tracks if turns is None else turns.undone(tracks)
        tracks, order = stages.sessions(tracks, model, settings=settings, report=report)
        order = order if turns is None else turns.with_order(order)
    return CheckedPoses(tracks, flying, order, copies, facts)


def _over_the_ground(
    tracks: Sequence[PoseTrack], model: ObjectModel, path: Path, settings: IngestSettings, report: Reporter
) -> tuple[Sequence[PoseTrack], float | None]:
    """Poses of a stated object, shifted so that it rests on z = 0, and the height at which it did [m].

    They stay, and the height is None, where that is z = 0 already, tosses do not agree, or `level=never` asks so.
    """
    heights = rest_heights(tracks, model)
    if not len(heights):
        return tracks, None
    ground = float(np.median(heights))
    agree = int(np.sum(np.abs(heights - ground) < LEVEL_HEIGHT))
    if abs(ground) < LEVEL_HEIGHT:
        return tracks, None
    found = f"{path}: tosses come to rest {1e3 * ground:.0f} mm {'above' if ground > 0 else 'below'} z = 0 (median)"
    if settings.level == "never" or agree < AGREE * len(heights):
        why = "as level=never asks" if settings.level == "never" else f"since only {agree} of {len(heights)} agree"
        report.problem("level", f"{found}; left as it is, {why}")
        return tracks, None
    report.problem(
        "level", f"{found}, as {agree} of {len(heights)} agree; the world is shifted so that the ground is z = 0"
    )
    return OnDemand(lambda i: turned_track(tracks[i], IDENTITY, -ground), len(tracks), kept=KEPT), ground


def read_links(source: Any, entry: InputFormat, report: Reporter) -> ImportedPoses:
    """The tracks of two links of which nothing is stated, with the hinge that they show.

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


def _levelled_by_hull(
    tracks: Sequence[PoseTrack], model: ObjectModel, path: Path, settings: IngestSettings, report: Reporter
) -> Sequence[PoseTrack]:
    """Tracks of an object of which nothing is stated, over the ground z = 0; `level=never` leaves them as they are."""
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


def _from_release(
    tracks: Sequence[PoseTrack], model: ObjectModel, *, touch: Touch | None, gravity: float, report: Reporter
) -> tuple[Sequence[PoseTrack], str]:
    """Ready tosses without first frames in which a hand still moves the object, and how many are left out of which.

    touch: where an object without corners may touch the ground.
    """
    first = release_frames(tracks, model, gravity=gravity, touch=touch)
    if not first.any():
        return tracks, ""
    held = {tracks[i].name: int(first[i]) for i in np.flatnonzero(first).tolist()}
    some = f"{len(held)} of {len(tracks)} tosses begin before the release"
    report.problem("import", f"{some}: {first.sum()} frames in which a hand moves them are left out")
    words = "; ".join(f"{name}: {count}" for name, count in held.items())
    return OnDemand(lambda i: tracks[i].frames(slice(int(first[i]), None)), len(tracks), kept=64), words
