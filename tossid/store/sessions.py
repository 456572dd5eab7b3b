"""The order of recording in a dataset's file: attributes only, which older readers pass over."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tossid.errors import FileError, InputError
from tossid.store.schema import MAX_ATTRIBUTE_TEXT, attribute
from tossid.types import RecordingOrder, Session

_WHOLE = "sessions"
_OF_TOSS = ("session", "recorded_as", "witnesses", "place_m", "turn", "shift_m")


def write_order(file: h5py.File, tosses: h5py.Group, order: RecordingOrder) -> None:
    """Write what is known of the order of recording, as far as it is of tosses in the file.

    Args:
        file: The dataset.
        tosses: Its group of tosses.
        order: What is written.

    Raises:
        InputError: The sessions are too many to be described in a file.
    """
    whole = {
        "ordered_by": order.ordered_by,
        "quantities": list(order.quantities),
        "notes": list(order.notes),
        "sessions": [asdict(session) for session in order.sessions],
    }
    text = json.dumps(whole, sort_keys=True)
    if len(text) > MAX_ATTRIBUTE_TEXT:
        raise InputError(f"{len(order.sessions)} sessions do not fit into an attribute of the file")
    file.attrs[_WHOLE] = text
    for place, name in enumerate(order.names):
        if name not in tosses:
            continue
        into = tosses[name].attrs
        into["session"], into["recorded_as"] = int(order.session_of[place]), place
        into["witnesses"], into["place_m"] = order.values[place], order.places[place]
        into["turn"], into["shift_m"] = order.turn[place], float(order.shift[place])


def read_order(path: Path, file: h5py.File, tosses: h5py.Group, names: Sequence[str]) -> RecordingOrder | None:
    """The order of recording of a file's tosses, None where it was not looked at.

    Args:
        path: The file, for errors.
        file: The dataset.
        tosses: Its group of tosses.
        names: Of the tosses that are asked for.

    Raises:
        FileError: It is not as `write_order` writes it.
    """
    if _WHOLE not in file.attrs:
        return None
    sessions, whole = _read_whole(path, attribute(path, file, _WHOLE, str))
    k = len(whole["quantities"])
    rows = [(_row(path, tosses[name], k), name) for name in names if "session" in tosses[name].attrs]
    rows.sort(key=lambda row: row[0]["recorded_as"])
    if any(not 0 <= row["session"] < len(sessions) for row, _ in rows):
        raise FileError(path, f"a toss names a session that is none of the {len(sessions)}")

    def column(name: str, *shape: int) -> Any:
        return np.array([row[name] for row, _ in rows], dtype=float).reshape(len(rows), *shape)

    return RecordingOrder(
        sessions,
        whole["ordered_by"],
        tuple(name for _, name in rows),
        tuple(whole["quantities"]),
        column("witnesses", k),
        column("place_m", 2),
        column("turn", 4),
        column("shift_m"),
        np.array([row["session"] for row, _ in rows], dtype=np.int64),
        tuple(whole["notes"]),
    )


def sessions_info(path: Path, file: h5py.File, names: Sequence[str]) -> list[dict[str, Any]]:
    """The sessions of a file as `tossid info` says them: one where no change was found or looked for.

    Args:
        path: The file, for errors.
        file: The dataset.
        names: Of its tosses, in their order.

    Returns:
        A dictionary a session: first, last, n_tosses, level_deg (None where the tosses do not decide it), and where
        the order was looked at level_sigma_deg, levelled, changed, note.
    """
    if _WHOLE not in file.attrs:
        return [{"first": names[0], "last": names[-1], "n_tosses": len(names), "level_deg": None}]
    sessions, _ = _read_whole(path, attribute(path, file, _WHOLE, str))
    return [session_facts(session) for session in sessions]


def session_facts(session: Session) -> dict[str, Any]:
    """A session by names and in degrees, as `tossid info` and reports have it.

    Args:
        session: Of a dataset.
    """
    facts = asdict(session)
    for name in ("level", "level_sigma"):
        value = facts.pop(name)
        facts[f"{name}_deg"] = None if value is None else np.rad2deg(value).tolist()
    return facts


def _read_whole(path: Path, text: str) -> tuple[tuple[Session, ...], dict[str, Any]]:
    try:
        whole = json.loads(text)
        sessions = tuple(_session(values) for values in whole["sessions"])
        lists = [whole["quantities"], whole["notes"]]
        if not sessions or any(not isinstance(word, str) for words in lists for word in [*words, whole["ordered_by"]]):
            raise ValueError("no sessions, or words that are none")
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise FileError(path, f"attribute 'sessions' does not describe the order of recording ({error})") from error
    return sessions, whole


def _session(values: dict[str, Any]) -> Session:
    def pair(name: str) -> tuple[float, float] | None:
        if values[name] is None:
            return None
        x, y = (float(value) for value in values[name])
        if not np.isfinite([x, y]).all():
            raise ValueError(f"{name} is not finite")
        return x, y

    return Session(
        str(values["first"]),
        str(values["last"]),
        int(values["n_tosses"]),
        pair("level"),
        pair("level_sigma"),
        bool(values["levelled"]),
        {str(name): float(p) for name, p in values["changed"].items()},
        str(values["note"]),
    )


def _row(path: Path, toss: h5py.Group, k: int) -> dict[str, Any]:
    """The attributes of one toss; turns are unit quaternions, and what was turned can be turned back."""
    row = {name: toss.attrs.get(name) for name in _OF_TOSS}
    sizes = {"session": (), "recorded_as": (), "witnesses": (k,), "place_m": (2,), "turn": (4,), "shift_m": ()}
    for name, shape in sizes.items():
        value = row[name]
        if value is None or np.shape(value) != shape or np.asarray(value).dtype.kind not in "if":
            raise FileError(path, f"attribute {name!r} of {toss.name} is {value!r}, expected numbers of shape {shape}")
        if name != "witnesses" and not np.isfinite(value).all():
            raise FileError(path, f"attribute {name!r} of {toss.name} is not finite")
    if abs(float(np.linalg.norm(row["turn"])) - 1) > 1e-6:
        raise FileError(path, f"attribute 'turn' of {toss.name} is no unit quaternion")
    return row
