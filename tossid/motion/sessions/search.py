"""The sessions of a recording, and how the world of each is tilted.

What tosses say of their recording (`witnesses`) is searched for changes over the order of recording
(`change_points`). A session's tilt is the weighted mean of two estimates: how objects fall, and the plane they stand
on. Where they disagree by more than their errors, the scatter between them is added to
each (DerSimonian and Laird 1986).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.motion.contact import lowest_corner
from tossid.motion.resting import support_plane
from tossid.motion.sessions import change_points
from tossid.motion.sessions.change_points import FEWEST, fewest_items, find_changes, robust_mean
from tossid.motion.sessions.levelling import IDENTITY, LEVEL_SIGMAS, SMALLEST_LEVEL, turned_track, upright
from tossid.motion.sessions.witnesses import COLUMNS, TILTS, Witnesses, toss_witnesses
from tossid.objects import ObjectModel
from tossid.types import OnDemand, PoseTrack, RecordingOrder, Session

Array = NDArray[np.float64]
Level = Literal["auto", "session", "always", "never"]

EXACTLY, SHIFTED_SHARE = 1e-9, 0.95
"""Heights were shifted toss by toss where this share of them end with the lowest corner within this of 0 [m]; noise is
at least a thousand times as much."""
_SAYS = {"fall": "flight", "normal": "rest on a face"}


class Tilt(NamedTuple):
    """Horizontal components of the vertical in a session's recorded world (2,) [rad], and their covariance (2, 2)."""

    up: Array
    cov: Array

    @property
    def is_off(self) -> bool:
        """Whether it is more than its error and than what matters."""
        sigmas = float(np.sqrt(self.up @ np.linalg.solve(self.cov, self.up)))
        return sigmas > LEVEL_SIGMAS and float(np.linalg.norm(self.up)) > SMALLEST_LEVEL


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
        note = "times of tosses overlap, so they are no clock of the recording: the order of names is used"
        return as_named, "names", (note,) if is_clock else ()
    if (order == as_named).all():
        return order, "times", ()
    first = int(np.argmax(order != as_named))
    note = (
        f"times and names contradict each other: by time, toss {tracks[order[first]].name} comes before "
        f"{tracks[first].name}; times are used"
    )
    return order, "times", (note,)


def find_sessions(
    tracks: Sequence[PoseTrack],
    model: ObjectModel,
    *,
    level: Level = "auto",
    advance: Callable[[int], None] = lambda count: None,
) -> RecordingOrder:
    """The sessions of a recording, and by how much the tosses of each would have to be turned and raised.

    Args:
        tracks: The tosses as recorded, z roughly up.
        model: The object.
        level: "never" only looks. "auto" and "always" level sessions where a tilt changes between them; "session"
            levels each, and one session too.
        advance: Called after each toss.

    Returns:
        The tosses in their order; `levelling.levelled_tracks` turns and raises them.
    """
    order, ordered_by, notes = recording_order(tracks)
    names = tuple(tracks[i].name for i in order)
    ordered = OnDemand(lambda i: tracks[order[i]], len(order), kept=0)
    seen = toss_witnesses(ordered, model, advance=advance)
    changes = find_changes(_quantities(seen))
    least = fewest_items(len(COLUMNS))
    if len(names) < least:
        notes += (f"{len(names)} tosses are too few for a change over their order to be seen; it takes {least}",)
    is_wanted = level == "session" or (level != "never" and any(name in TILTS for each in changes for name in each.p))
    turn, session_of = np.tile(IDENTITY, (len(names), 1)), np.zeros(len(names), np.int64)
    sessions = []
    edges = [0, *(change.at for change in changes), len(names)]
    for number, part in enumerate(slice(a, b) for a, b in pairwise(edges)):
        tilt, note = _session_tilt(seen, part)
        levelled = tilt is not None and is_wanted and tilt.is_off
        if tilt is not None and levelled:
            turn[part] = upright(np.append(tilt.up, np.sqrt(1 - tilt.up @ tilt.up)))
        session_of[part] = number
        session = Session(
            names[part.start],
            names[part.stop - 1],
            part.stop - part.start,
            None if tilt is None else (float(tilt.up[0]), float(tilt.up[1])),
            None if tilt is None else (float(np.sqrt(tilt.cov[0, 0])), float(np.sqrt(tilt.cov[1, 1]))),
            levelled=bool(levelled),
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
        np.zeros(len(names)),
        session_of,
        notes,
    )
    return _raised(found, ordered, model, heights_were_shifted(seen.last_low), is_wanted)


def _quantities(seen: Witnesses) -> dict[str, change_points.Sequence]:
    """Witnesses with what else they may depend on: place, and of a fall the velocity."""
    both = np.column_stack([seen.places, seen.speeds])
    covariates = {"fall": both, "gravity": both}
    return {
        name: change_points.Sequence(seen.values[name], seen.info[name], covariates.get(name, seen.places))
        for name in COLUMNS
    }


def _session_tilt(seen: Witnesses, part: slice) -> tuple[Tilt | None, str]:
    """The tilt of a session's world from rest and flight together.

    None where one of them does not show it; and which does not, in words.
    """
    means = {name: robust_mean(seen.values[name][part], seen.info[name][part]) for name in TILTS}
    shown = [mean for mean in means.values() if mean.n >= FEWEST and np.isfinite(mean.value).all()]
    missing = [_SAYS[name] for name, mean in means.items() if mean not in shown]
    note = f"{' and '.join(missing)} in fewer than {FEWEST} tosses" if missing else ""
    if len(shown) < 2:
        return None, f"{note}: its tilt is not decided"
    return _combined(np.array([mean.value for mean in shown]), np.array([mean.cov for mean in shown])), note


def _combined(y: Array, C: Array) -> Tilt:
    """Weighted mean of two estimates (2, 2) with covariances (2, 2, 2), with the scatter between them added to each."""
    # DerSimonian and Laird's moment estimate of each axis; the larger is taken for both, since a recording in a plane
    # has no scatter across it
    between = max(0.0, float(np.max((y[0] - y[1]) ** 2 - np.diagonal(C.sum(axis=0))) / 2))
    W = np.linalg.inv(C + (between + 1e-18) * np.eye(2))
    cov = np.linalg.inv(W.sum(axis=0))
    return Tilt(cov @ np.einsum("kij,kj->i", W, y), cov)


def heights_were_shifted(last_low: Array) -> bool:
    """Whether every toss was shifted so that the lowest stated corner of its last frame lies at z = 0.

    Args:
        last_low: As of `Witnesses`, (n, 2) [m].
    """
    before, last = np.abs(last_low).T
    return bool(np.mean(last < EXACTLY) >= SHIFTED_SHARE and np.median(before) > 1e3 * EXACTLY)


def _raised(
    found: RecordingOrder, tracks: Sequence[PoseTrack], model: ObjectModel, was_shifted: bool, is_wanted: bool
) -> RecordingOrder:
    """With the shifts that put the ground of levelled sessions, or of tosses that were shifted one by one, at z = 0."""
    shifted = "every toss was shifted so that its last frame's lowest corner is at 0"
    if not is_wanted:
        return replace(found, notes=(*found.notes, f"{shifted}; it is left so")) if was_shifted else found
    levelled = np.array([session.levelled for session in found.sessions])
    ground, low = np.full((2, len(tracks)), np.nan)
    for i in np.flatnonzero(levelled[found.session_of] | was_shifted).tolist():
        track = turned_track(tracks[i], found.turn[i], 0.0)
        plane = support_plane(track, model)
        ground[i], low[i] = np.nan if plane is None else plane.height, lowest_corner(model, track.q).min()
    known, shift, notes = np.isfinite(ground), found.shift.copy(), found.notes
    if was_shifted and known.any():
        # the lowest corner of all frames is as far below the ground in tosses that do not come to rest as in the others
        shift = -np.where(known, ground, low + np.median((ground - low)[known]))
        notes = (*notes, f"{shifted}; raised to where it rests or touches")
    for number in np.flatnonzero(levelled & (not was_shifted)):
        own = found.session_of == number
        if (own & known).any():
            shift[own] = -np.median(ground[own & known])
    return replace(found, shift=shift, notes=notes)


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
