"""The order of recording in a dataset's file: attributes only, which older readers pass over."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import h5py
import numpy as np

from tossid.errors import ConfigError, FileError, InputError
from tossid.settings.kinds import convert, to_plain
from tossid.store.hdf5 import CheckedGroup
from tossid.store.schema import MAX_ATTRIBUTE_TEXT
from tossid.types import RecordingOrder, Session


@dataclass(frozen=True)
class _Recording:
    """What of the order of recording is no toss's own: the file's attribute `sessions`, as JSON."""

    ordered_by: str
    quantities: tuple[str, ...]
    notes: tuple[str, ...]
    sessions: tuple[Session, ...]


def write_order(file: h5py.File, tosses: h5py.Group, order: RecordingOrder) -> None:
    """Write what is known of the order of recording, as far as it is of tosses in the file.

    Raises:
        InputError: The sessions are too many to be described in a file.
    """
    recording = _Recording(order.ordered_by, order.quantities, order.notes, order.sessions)
    text = json.dumps(to_plain(recording), sort_keys=True)
    if len(text) > MAX_ATTRIBUTE_TEXT:
        raise InputError(f"{len(order.sessions)} sessions do not fit into an attribute of the file")
    file.attrs["sessions"] = text
    for place, name in enumerate(order.names):
        if name not in tosses:
            continue
        into = tosses[name].attrs
        into["session"], into["recorded_as"] = int(order.session_of[place]), place
        into["witnesses"], into["place_m"] = order.values[place], order.places[place]
        into["turn"], into["shift_m"] = order.turn[place], float(order.shift[place])


def read_order(file: CheckedGroup, names: Sequence[str]) -> RecordingOrder | None:
    """The order of recording of a file's tosses, None where it was not looked at.

    Args:
        file: The dataset.
        names: Of the tosses that are asked for.

    Raises:
        FileError: It is not as `write_order` writes it.
    """
    recording = _read_recording(file)
    if recording is None:
        return None
    tosses = file.group("tosses")
    rows = []
    for name in names:
        toss = tosses.group(name)
        if "session" not in toss.attributes:
            continue
        turn = toss.numbers("turn", (4,))
        if abs(float(np.linalg.norm(turn)) - 1) > 1e-6:
            raise FileError(file.path, f"attribute 'turn' of {toss.name} is no unit quaternion")
        session, place = (int(toss.numbers(key, ())) for key in ("session", "recorded_as"))
        if not 0 <= session < len(recording.sessions):
            raise FileError(file.path, f"a toss names a session that is none of the {len(recording.sessions)}")
        witnesses = toss.numbers("witnesses", (len(recording.quantities),), finite=False)
        rows.append((place, name, session, witnesses, toss.numbers("place_m", (2,)), turn, toss.numbers("shift_m", ())))
    rows.sort(key=lambda row: row[0])

    def column(which: int, *shape: int) -> np.ndarray:
        return np.array([row[which] for row in rows], dtype=float).reshape(len(rows), *shape)

    return RecordingOrder(
        sessions=recording.sessions,
        ordered_by=recording.ordered_by,
        names=tuple(row[1] for row in rows),
        quantities=recording.quantities,
        values=column(3, len(recording.quantities)),
        places=column(4, 2),
        turn=column(5, 4),
        shift=column(6),
        session_of=np.array([row[2] for row in rows], dtype=np.int64),
        notes=recording.notes,
    )


def sessions_info(file: CheckedGroup, names: Sequence[str]) -> list[dict[str, Any]]:
    """The sessions of a file as `tossid info` says them: one where no change was found or looked for.

    Args:
        file: The dataset.
        names: Of its tosses, in their order.

    Returns:
        A dictionary a session: first, last, n_tosses, level_deg (None where the tosses do not decide it), and where
        the order was looked at level_sigma_deg, levelled, changed, note.
    """
    recording = _read_recording(file)
    if recording is None:
        return [{"first": names[0], "last": names[-1], "n_tosses": len(names), "level_deg": None}]
    return [_in_degrees(session) for session in recording.sessions]


def _in_degrees(session: Session) -> dict[str, Any]:
    facts = asdict(session)
    for name in ("level", "level_sigma"):
        value = facts.pop(name)
        facts[f"{name}_deg"] = None if value is None else np.rad2deg(value).tolist()
    return facts


def _read_recording(file: CheckedGroup) -> _Recording | None:
    if "sessions" not in file.attributes:
        return None
    try:
        found: _Recording = convert(_Recording, json.loads(file.attribute("sessions", str)), key="sessions")
    except (ConfigError, ValueError, RecursionError) as error:
        problem = f"does not describe the order of recording ({error})"
        raise FileError(file.path, f"attribute 'sessions' {problem}") from error
    if not found.sessions:
        raise FileError(file.path, "attribute 'sessions' does not describe the order of recording (no sessions)")
    return found
