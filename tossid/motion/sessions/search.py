"""The sessions of a recording, and how the world of each is tilted.

What tosses say of their recording (`witnesses`) is searched for changes over the order of recording
(`change_points`). A session's tilt is the weighted mean of three estimates: how objects fall, the faces they rest on,
and the points at which they touch. Where they disagree by more than their errors, the scatter between them is added to
each (DerSimonian and Laird 1986).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tossid.motion.ground_plane import upright
from tossid.motion.sessions.change_points import Change, fewest_items, find_changes, robust_mean
from tossid.motion.sessions.levelling import IDENTITY, turned_track
from tossid.motion.sessions.witnesses import (
    COLUMNS,
    TILTS,
    Witnesses,
    contact_points,
    link_faces,
    resting_faces,
    toss_witnesses,
)
from tossid.objects import GRAVITY, ObjectModel, corner_positions
from tossid.settings.sessions import SessionSettings, WitnessSettings
from tossid.types import OnDemand, PoseTrack, RecordingOrder, Session

Array = NDArray[np.float64]
Level = Literal["auto", "session", "always", "never"]

DEFAULT = SessionSettings()
WITNESS = WitnessSettings()


@dataclass(frozen=True, eq=False)
class Tilt:
    """How a session's world is tilted.

    Attributes:
        up: Horizontal components of the vertical in the recorded world [rad], (2,).
        cov: Their covariance, (2, 2).
        by_witness: Each estimate of it [rad], (2,).
    """

    up: Array
    cov: Array
    by_witness: dict[str, Array]


def recording_order(tracks: Sequence[PoseTrack]) -> tuple[NDArray[np.int64], str, tuple[str, ...]]:
    """The order in which tosses were recorded: by their times, or as they come (names, 2 before 10).

    Args:
        tracks: One a toss.

    Returns:
        Indices in the order of recording; "times" or "names"; and what contradicts it.
    """
    starts, stops = (np.array([track.t[end] for track in tracks]) for end in (0, -1))
    as_named, order = np.arange(len(tracks)), np.argsort(starts, kind="stable")
    if len(tracks) < 2 or np.ptp(starts) == 0:
        return as_named, "names", ()
    if (starts[order][1:] < stops[order][:-1]).any():
        # (clocks that start anew with every toss, at about 0)
        is_clock = np.ptp(starts) > np.median(stops - starts)
        said = "times of tosses overlap, so they are no clock of the recording: the order of names is used"
        return as_named, "names", (said,) if is_clock else ()
    if (order != as_named).any():
        first = int(np.argmax(order != as_named))
        said = (
            f"times and names contradict each other: by time, toss {tracks[order[first]].name} comes before "
            f"{tracks[as_named[first]].name}; times are used"
        )
        return order, "times", (said,)
    return order, "times", ()


def find_sessions(
    tracks: Sequence[PoseTrack],
    model: ObjectModel,
    *,
    gravity: float = GRAVITY,
    level: Level = "auto",
    settings: SessionSettings = DEFAULT,
    witness: WitnessSettings = WITNESS,
    advance: Callable[[int], None] = lambda count: None,
) -> RecordingOrder:
    """The sessions of a recording, and by how much the tosses of each would have to be turned and raised.

    Args:
        tracks: The tosses as recorded, z roughly up.
        model: The object.
        gravity: Where they were recorded [m/s²].
        level: "never" only looks. "auto" and "always" level sessions where a tilt changes between them; "session"
            levels each, and one session too.
        settings: When a change is one, and when a tilt is.
        witness: What counts as flight, rest and contact.
        advance: Called after each toss.

    Returns:
        The tosses in their order; `levelling.levelled_tracks` turns and raises them.
    """
    order, ordered_by, notes = recording_order(tracks)
    names = tuple(tracks[i].name for i in order)
    ordered = OnDemand(lambda i: tracks[order[i]], len(order), kept=0)
    seen = toss_witnesses(ordered, model, gravity=gravity, settings=witness, advance=advance)
    changes = find_changes(with_covariates(seen), settings=settings)
    least = fewest_items(len(COLUMNS), settings)
    if len(names) < least:
        notes += (f"{len(names)} tosses are too few for a change over their order to be seen; it takes {least}",)
    edges = [0, *(change.at for change in changes), len(names)]
    parts = [slice(a, b) for a, b in pairwise(edges)]
    tilts = [session_tilt(seen.of(part), settings) for part in parts]
    is_wanted = level == "session" or (level != "never" and any(_tilts(change) for change in changes))
    turn, shift = np.tile(IDENTITY, (len(names), 1)), np.zeros(len(names))
    sessions = []
    for number, (part, (tilt, note)) in enumerate(zip(parts, tilts, strict=True)):
        is_off = tilt is not None and _is_off(tilt, settings)
        if is_wanted and tilt is not None and is_off:
            turn[part] = upright(np.append(tilt.up, np.sqrt(1 - tilt.up @ tilt.up)))
        session = Session(
            names[part.start],
            names[part.stop - 1],
            part.stop - part.start,
            None if tilt is None else (float(tilt.up[0]), float(tilt.up[1])),
            None if tilt is None else (float(np.sqrt(tilt.cov[0, 0])), float(np.sqrt(tilt.cov[1, 1]))),
            levelled=bool(is_wanted and is_off),
            changed=dict(changes[number - 1].p) if number else {},
            note=note,
        )
        sessions.append(session)
    found = RecordingOrder(
        tuple(sessions),
        ordered_by,
        names,
        tuple(name for components in COLUMNS.values() for name in components),
        np.concatenate([seen.values[name] for name in COLUMNS], axis=1),
        seen.places,
        turn,
        shift,
        np.repeat(np.arange(len(parts)), [part.stop - part.start for part in parts]),
        notes,
    )
    return _raised(found, ordered, model, seen, is_wanted, settings, witness)


def session_tilt(seen: Witnesses, settings: SessionSettings = DEFAULT) -> tuple[Tilt | None, str]:
    """The tilt of a session's world from rest, contact and flight together.

    Args:
        seen: What its tosses say.
        settings: From how many tosses an estimate is made.

    Returns:
        The tilt, None where fewer than two of the three show it; and which do not, in words.
    """
    means, covs = {}, {}
    for name in TILTS:
        mean = robust_mean(seen.values[name], seen.info[name], outlier=settings.outlier)
        if mean.n >= settings.fewest_tosses and np.isfinite(mean.value).all():
            means[name], covs[name] = mean.value, mean.cov
    missing = [_SAYS[name] for name in TILTS if name not in means]
    note = f"{' and '.join(missing)} in fewer than {settings.fewest_tosses} tosses" if missing else ""
    if len(means) < 2:
        return None, f"{note}: its tilt is not decided"
    y, C = np.array(list(means.values())), np.array(list(covs.values()))
    up, cov = _combined(y, C)
    return Tilt(up, cov, means), note


_SAYS = {"fall": "flight", "normal": "rest on a face", "slope": "contact in two places"}


def _combined(y: Array, C: Array) -> tuple[Array, Array]:
    """Weighted mean of estimates (k, 2) with covariances (k, 2, 2), with the scatter between them added to each."""
    k, eye = len(y), np.eye(2)
    C = C + (1e-9) ** 2 * eye
    W = np.linalg.inv(C)
    total = W.sum(axis=0)
    mean = np.linalg.solve(total, np.einsum("kij,kj->i", W, y))
    off = y - mean
    w = np.diagonal(W, axis1=1, axis2=2)
    Q = np.einsum("ki,ki->i", w, off**2)
    # of each axis; the larger is taken for both, since a recording in a plane has no scatter across it
    between = max(0.0, float(np.max((Q - (k - 1)) / (w.sum(axis=0) - (w**2).sum(axis=0) / w.sum(axis=0)))))
    W = np.linalg.inv(C + between * eye)
    cov = np.linalg.inv(W.sum(axis=0))
    return cov @ np.einsum("kij,kj->i", W, y), cov


def _is_off(tilt: Tilt, settings: SessionSettings) -> bool:
    """Whether a tilt is more than its error and than what matters."""
    sigmas = float(np.sqrt(tilt.up @ np.linalg.solve(tilt.cov, tilt.up)))
    return sigmas > settings.level_sigmas and float(np.linalg.norm(tilt.up)) > settings.smallest_level


def _tilts(change: Change) -> bool:
    return any(name in change.p for name in TILTS)


def with_covariates(seen: Witnesses) -> dict[str, tuple[Array, Array, Array]]:
    """Witnesses with what else they may depend on, as `find_changes` takes them: place, and of a fall the velocity.

    Args:
        seen: What tosses say.
    """
    both = np.column_stack([seen.places, seen.speeds])
    return {
        name: (seen.values[name], seen.info[name], both if name in ("fall", "gravity") else seen.places)
        for name in COLUMNS
    }


def heights_were_shifted(last_low: Array, settings: SessionSettings = DEFAULT) -> bool:
    """Whether every toss was shifted so that the lowest stated corner of its last frame lies at z = 0.

    Args:
        last_low: As of `Witnesses`, (n, 2) [m].
        settings: What is exact, and how many tosses must be.
    """
    before, last = np.abs(last_low).T
    exact = bool(np.mean(last < settings.exactly) >= settings.shifted_share)
    return exact and bool(np.median(before) > 1e3 * settings.exactly)


def _raised(
    found: RecordingOrder,
    tracks: Sequence[PoseTrack],
    model: ObjectModel,
    seen: Witnesses,
    is_wanted: bool,
    settings: SessionSettings,
    witness: WitnessSettings,
) -> RecordingOrder:
    """With the shifts that put the ground of levelled sessions, or of tosses that were shifted one by one, at z = 0."""
    was_shifted = heights_were_shifted(seen.last_low, settings)
    notes, faces = found.notes, link_faces(model)
    if not is_wanted:
        if was_shifted:
            notes += ("every toss was shifted so that its last frame's lowest corner is at 0; it is left so",)
        return replace(found, notes=notes)
    shift, undecided, turned = found.shift.copy(), 0, np.array([s.levelled for s in found.sessions])[found.session_of]
    ground, info = np.zeros(len(tracks)), np.zeros(len(tracks))
    for i in np.flatnonzero(turned | was_shifted).tolist():
        track = turned_track(tracks[i], found.turn[i], 0.0)
        ground[i], info[i] = _ground(track, model, faces, settings, witness)
    if was_shifted:
        decided = info > 0
        shift[decided], undecided = -ground[decided], int(np.sum(~decided))
        said = (
            "every toss was shifted so that its last frame's lowest corner is at 0; raised to where it rests or touches"
        )
        notes += (said + (f" ({undecided} that do neither are left)" if undecided else ""),)
    for number in np.flatnonzero([session.levelled for session in found.sessions]):
        own = found.session_of == number
        rows = own & (info > 0)
        mean = robust_mean(ground[rows, None], info[rows, None, None], outlier=settings.outlier)
        if not was_shifted:
            shift[own] = -mean.value[0]
        elif rows.any():
            shift[own & (info == 0)] = -mean.value[0]
    return replace(found, shift=shift, notes=notes)


def _ground(
    track: PoseTrack,
    model: ObjectModel,
    faces: list[tuple[int, Array, NDArray[np.int64]]],
    settings: SessionSettings,
    witness: WitnessSettings,
) -> tuple[float, float]:
    """The ground's height that a toss shows [m] and its information; 0, 0 where it neither rests nor touches twice.

    No corner is below ground: a link that lies on another one, or a corner that turns back in mid-air, says nothing.
    """
    corners = corner_positions(model, track.q)
    low = corners[..., 2].min(axis=1)
    resting = resting_faces(track, model, faces, settings=witness)
    resting = resting[resting[:, 2] < low[-1] + settings.above_lowest]
    points = contact_points(corners, low, settings=witness)
    points = points[points[:, 2] < low.min() + settings.above_lowest]
    heights, info = list(resting[:, 2]), [settings.rest_error**-2] * len(resting)
    if len(points) >= 2 or len(resting):
        heights += list(points[:, 2])
        info += [witness.contact_error**-2] * len(points)
    if not info:
        return 0.0, 0.0
    return float(np.average(heights, weights=info)), float(np.sum(info))


def session_words(session: Session) -> str:
    """A session in a line.

    Args:
        session: Of a recording.
    """
    about = f"{session.first} to {session.last} ({session.n_tosses} tosses)"
    if session.changed:
        p = max(session.changed.values())
        about += f", {', '.join(session.changed)} changed before it (p < {p:.2g})"
    if session.level is None or session.level_sigma is None:
        return f"{about}: {session.note}"
    size, sigma = np.rad2deg(np.hypot(*session.level)), np.rad2deg(max(session.level_sigma))
    done = "levelled (level=never leaves it)" if session.levelled else "left as it is"
    note = f" ({session.note})" if session.note else ""
    return f"{about}: its world is tilted by {size:.2f}° ± {sigma:.2f}°{note}; {done}"
