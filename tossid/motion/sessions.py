"""Sessions: stretches of a recording between which a camera was bumped, a table cleaned, a calibration redone.

What tosses say of their recording (`tossid.motion.witnesses`) is searched for changes over the order of recording
(`tossid.motion.change_points`). A session's tilt is the weighted mean of three estimates: how objects fall, the faces
they rest on, and the points at which they touch. Where they disagree by more than their errors, the scatter between
them is added to each (DerSimonian and Laird 1986).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tossid.motion.change_points import Change, fewest_items, find_changes, robust_mean
from tossid.motion.ground_plane import upright
from tossid.motion.witnesses import (
    COLUMNS,
    TILTS,
    Witnesses,
    contact_points,
    link_faces,
    resting_faces,
    toss_witnesses,
)
from tossid.objects import GRAVITY, ObjectModel, corner_positions
from tossid.rotations import quat_conj, quat_mul, quat_rotate, quat_to_matrix
from tossid.settings.sessions import SessionSettings, WitnessSettings
from tossid.types import OnDemand, PoseTrack, RecordingOrder, Session, Toss

Array = NDArray[np.float64]
Level = Literal["auto", "session", "always", "never"]

DEFAULT = SessionSettings()
WITNESS = WitnessSettings()
IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
_KEPT = 256
"""Levelled tracks that stay in memory."""


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
        The tosses in their order; `levelled_tracks` turns and raises them.
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


def heights_were_shifted(seen: Witnesses, settings: SessionSettings = DEFAULT) -> bool:
    """Whether every toss was shifted so that the lowest stated corner of its last frame lies at z = 0.

    Args:
        seen: What the tosses say.
        settings: What is exact, and how many tosses must be.
    """
    before, last = np.abs(seen.last_low).T
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
    was_shifted = heights_were_shifted(seen, settings)
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
    """The ground's height that a toss shows [m], and its information; 0, 0 where it neither rests nor touches twice."""
    resting = resting_faces(track, model, faces, settings=witness)
    corners = corner_positions(model, track.q)
    points = contact_points(corners, corners[..., 2].min(axis=1), settings=witness)
    heights, info = list(resting[:, 2]), [settings.rest_error**-2] * len(resting)
    if len(points) >= 2 or len(resting):
        heights += list(points[:, 2])
        info += [witness.contact_error**-2] * len(points)
    if not info:
        return 0.0, 0.0
    return float(np.average(heights, weights=info)), float(np.sum(info))


def levelled_tracks(tracks: Sequence[PoseTrack], found: RecordingOrder) -> Sequence[PoseTrack]:
    """The tracks, turned and raised as `find_sessions` found; the same ones where nothing is to be done.

    Args:
        tracks: As recorded.
        found: What was found of them.
    """
    if not (found.shift.any() or (found.turn != IDENTITY).any()):
        return tracks
    at = {name: i for i, name in enumerate(found.names)}

    def levelled(i: int) -> PoseTrack:
        k = at[tracks[i].name]
        return turned_track(tracks[i], found.turn[k], float(found.shift[k]))

    return OnDemand(levelled, len(tracks), kept=_KEPT)


def turned_track(track: PoseTrack, turn: Array, shift: float) -> PoseTrack:
    """A track in a world that is turned and then raised.

    Args:
        track: In the recorded world.
        turn: Quaternion wxyz, (4,).
        shift: Added to heights after the turn [m].
    """
    q, v, cov = _turned(track.q, turn), track.v, track.q_cov
    q[:, 2] += shift
    if v is not None:
        v = _turned_velocity(v, turn)
    return PoseTrack(track.name, track.t, q, None if cov is None else _turned_cov(cov, turn), v)


def as_recorded(toss: Toss, found: RecordingOrder) -> Toss:
    """A toss as it was recorded, before its session was levelled.

    Args:
        toss: Of a dataset.
        found: The dataset's order of recording.
    """
    k = found.names.index(toss.name)
    if not found.shift[k] and (found.turn[k] == IDENTITY).all():
        return toss
    back = quat_conj(found.turn[k])

    def pose(q: Array) -> Array:
        lowered = q.copy()
        lowered[:, 2] -= found.shift[k]
        return _turned(lowered, back)

    measured, measured_cov = toss.q_measured, toss.q_measured_cov
    return replace(
        toss,
        q=pose(toss.q),
        v=_turned_velocity(toss.v, back),
        q_cov=_turned_cov(toss.q_cov, back),
        v_cov=_turned_cov(toss.v_cov, back),
        q_measured=None if measured is None else pose(measured),
        q_measured_cov=None if measured_cov is None else _turned_cov(measured_cov, back),
    )


def _turned(q: Array, turn: Array) -> Array:
    """Configurations (n, nq) in a turned world."""
    out, turns = q.copy(), np.broadcast_to(turn, (len(q), 4))
    out[:, :3] = quat_rotate(turns, q[:, :3])
    out[:, 3:7] = quat_mul(turns, q[:, 3:7])
    return out


def _turned_velocity(v: Array, turn: Array) -> Array:
    out = v.copy()
    out[:, :3] = quat_rotate(np.broadcast_to(turn, (len(v), 4)), v[:, :3])
    return out


def _turned_cov(cov: Array, turn: Array) -> Array:
    """Covariances (n, nv, nv), whose first three coordinates are of the world."""
    T = np.eye(cov.shape[-1])
    T[:3, :3] = quat_to_matrix(turn)
    return np.asarray(T @ cov @ T.T)


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
