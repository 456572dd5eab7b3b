"""Datasets from HDF5, checked: a file that is damaged, or not what it says, is one clear error."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tossid import budget
from tossid.errors import FileError, MotionError, ObjectError
from tossid.objects import ObjectModel, unstated_object
from tossid.objects.unstated import UNKNOWN, Hinge
from tossid.store.dataset import Dataset
from tossid.store.hashing import file_sha256
from tossid.store.hdf5 import CheckedGroup, explained, opened
from tossid.store.object_text import model_of_text
from tossid.store.schema import CONTACT_LAW, KNOWN_SCHEMAS, MEMBERS, TAG_DTYPE
from tossid.store.sessions import read_order, sessions_info
from tossid.types import OnDemand, Phase, Toss

KEPT = 256
"""Tosses of an open dataset that stay in memory."""


def read_dataset(path: str | Path) -> Dataset:
    """Read a dataset that `write_dataset` or another program wrote in its schema, all of it into memory.

    Args:
        path: The file (.h5).

    Raises:
        FileError: It is missing, damaged, of an unknown schema, or holds what is no motion; the error names the file
            and the group.
    """
    with open_dataset(Path(path)) as dataset:
        return replace(dataset, tosses=tuple(dataset.tosses))


@contextmanager
def open_dataset(path: Path, *, split: str | None = None) -> Iterator[Dataset]:
    """A dataset whose tosses are read when they are asked for, while the block lasts; a few stay in memory.

    Args:
        path: The file (.h5).
        split: Only the tosses of this split; None for all.

    Yields:
        The dataset.

    Raises:
        FileError: As `read_dataset`; what is wrong with a toss, when it is read.
    """
    path = Path(path)
    with opened(path) as file:
        with explained(path):
            names = _toss_names(file)
            tosses = file.group("tosses")
            if split is not None:
                names = [name for name in names if tosses.group(name).attribute("split", str) == split]
            whole = Dataset(
                object=_read_object(file.group("object")),
                tosses=(),
                rate_hz=_rate(file),
                source=file.attribute("source", str),
                provenance=_read_provenance(file.group("provenance")),
                order=read_order(file, names),
            )
        bytes_of: dict[int, int] = {}  # of each toss that was read, which may be links to the same arrays
        total = 0

        def read(i: int) -> Toss:
            nonlocal total
            with explained(path):
                others = total - bytes_of.get(i, 0)
                toss, bytes_of[i] = _read_toss(tosses.group(names[i]), whole.object, others)
                total = others + bytes_of[i]
                return toss

        yield replace(whole, tosses=OnDemand(read, len(names), kept=KEPT))


def dataset_info(path: Path) -> dict[str, Any]:
    """What is in a dataset, without reading its motions.

    Args:
        path: The file (.h5).

    Returns:
        schema, object, n_joints, n_tosses, n_frames, rate_hz, duration_s, source,
        covariance_source, splits (tosses a split), phases (frames a phase),
        sessions (a list, see `tossid.store.sessions.sessions_info`), provenance, sha256 (of the file).

    Raises:
        FileError: As `read_dataset`, for what is looked at.
    """
    path = Path(path)
    with opened(path) as file, explained(path):
        names, model, tosses = _toss_names(file), file.group("object"), file.group("tosses")
        nq, nv = model.attribute("nq", int), model.attribute("nv", int)
        splits, phases = Counter[str](), np.zeros(max(Phase) + 1, dtype=int)
        duration, claimed = 0.0, 0
        for name in names:
            toss = tosses.group(name)
            data = _arrays(toss, nq, nv, claimed)
            claimed += sum(array.nbytes for array in data.values())
            phases += np.bincount(_checked_phase(toss, data["phase"][()]), minlength=len(phases))
            splits[toss.attribute("split", str) or "none"] += 1
            duration += float(data["t"][-1] - data["t"][0])
        return {
            "schema": file.attribute("schema", str),
            "object": model.attribute("name", str),
            "n_joints": nv - 6,
            "n_tosses": len(names),
            "n_frames": int(phases.sum()),
            "rate_hz": _rate(file),
            "duration_s": duration,
            "source": file.attribute("source", str),
            "covariance_source": file.attribute("covariance_source", str),
            "splits": dict(sorted(splits.items(), key=lambda item: "" if item[0] == "none" else item[0])),
            "phases": {phase.name.lower(): int(phases[phase]) for phase in Phase if phases[phase]},
            "sessions": sessions_info(file, names),
            "provenance": _read_provenance(file.group("provenance")),
            "sha256": file_sha256(path),
        }


def _toss_names(file: CheckedGroup) -> list[str]:
    """The tosses' names, in their order, of a file whose schema is known."""
    known = ", ".join(KNOWN_SCHEMAS)
    if "schema" not in file.attributes:
        raise FileError(file.path, f"an HDF5 file without a schema, expected {known}")
    schema = file.attribute("schema", str)
    if schema not in KNOWN_SCHEMAS:
        raise FileError(file.path, f"schema {schema!r} is unknown; this version of tossid reads {known}")
    file.refuse_others({"object", "provenance", "tosses"})
    tosses = file.group("tosses")
    names = tosses.members
    places = [tosses.group(name).attribute("index", int) for name in names]
    if sorted(places) != list(range(len(names))):
        raise FileError(file.path, "the tosses' index attributes are not 0, 1, 2, …")
    if len(names) != file.attribute("n_tosses", int) or not names:
        raise FileError(file.path, f"/tosses holds {len(names)} tosses, n_tosses says {file.value('n_tosses')}")
    return [name for _, name in sorted(zip(places, names, strict=True))]


def _arrays(toss: CheckedGroup, nq: int, nv: int, others: int) -> dict[str, h5py.Dataset]:
    """The arrays of a toss, each checked; others: bytes of tosses before it, which may be links to the same arrays."""
    toss.refuse_others({member.name for member in MEMBERS})
    sizes: dict[str, int | None] = {"n": None, "nq": nq, "nv": nv}
    found = {}
    for member in MEMBERS:
        if member.optional and member.name not in toss.members:
            continue
        shape = tuple(sizes[name] for name in member.shape)
        data = toss.array(member.name, member.dtype, shape, others=others)
        others += data.nbytes
        sizes["n"] = data.shape[0]
        if data.shape[0] < 2:
            raise FileError(toss.path, f"{toss.name} has {data.shape[0]} frames, expected at least 2")
        found[member.name] = data
    return found


def _read_toss(group: CheckedGroup, model: ObjectModel, others: int) -> tuple[Toss, int]:
    """A toss and its bytes; others: bytes of the tosses that were read of the file."""
    arrays = _arrays(group, model.nq, model.nv, others)
    name, split = group.name.rsplit("/", 1)[1], group.attribute("split", str)
    try:
        toss = Toss(name=name, split=split, **{key: data[()] for key, data in arrays.items()})
    except MotionError as error:
        row = None if error.row is None else f"{group.name}, frame {error.row}"
        raise FileError(group.path, error.problem, row=row or group.name) from error
    _checked_phase(group, toss.phase)
    return toss, sum(data.nbytes for data in arrays.values())


def _checked_phase(toss: CheckedGroup, phase: np.ndarray) -> np.ndarray:
    if phase.max() > max(Phase):
        raise FileError(toss.path, f"{toss.name}/phase holds {phase.max()}, expected at most {max(Phase)}")
    return phase


def _read_object(group: CheckedGroup) -> ObjectModel:
    group.refuse_others({"mjcf", "tags", "hinge"})
    name = group.attribute("name", str)
    if name == UNKNOWN and set(group.members) <= {"hinge"}:
        model = unstated_object(hinge=_read_hinge(group) if group.members else None)
    else:
        model = _read_stated(group, name)
    if (model.nq, model.nv) != (group.attribute("nq", int), group.attribute("nv", int)):
        raise FileError(group.path, f"/object has {model.n_joints} joints, the attributes nq and nv say otherwise")
    return model


def _read_stated(group: CheckedGroup, name: str) -> ObjectModel:
    stored = group.array("mjcf", "|u1", (None,))
    budget.check_claim(group.path, "bytes of /object/mjcf", stored.shape[0], budget.limits().model_text)
    tags = None
    if "tags" in group.members:
        rows = group.array("tags", TAG_DTYPE, (None,))
        budget.check_claim(group.path, "tags", rows.shape[0], budget.limits().tags)
        tags = rows[()]
    try:
        return model_of_text(
            stored[()].tobytes().decode(),
            tags=tags,
            name=name,
            width=group.attribute("width_m", float),
            **{key: group.attribute(key, float) for key in ("friction", "restitution")},
            **{key: group.attribute(key, float, default=0.0) for key in CONTACT_LAW},
        )
    except ObjectError as error:
        raise FileError(group.path, f"/object: {error}") from error


def _read_hinge(group: CheckedGroup) -> Hinge:
    values = group.array("hinge", "<f8", (13,))[()]
    hinge = Hinge(*np.split(values, [3, 7, 10]))
    unit = all(abs(np.linalg.norm(part) - 1) < 1e-6 for part in (hinge.body_quat, hinge.axis))
    if not np.isfinite(values).all() or not unit:
        raise FileError(
            group.path, "/object/hinge is no hinge: not finite, or its quaternion or axis is not of length 1"
        )
    return hinge


def _read_provenance(group: CheckedGroup) -> dict[str, Any]:
    group.refuse_others(set())
    out = {key: group.value(key) for key in group.attributes}
    for key, value in out.items():
        if not isinstance(value, str | int | float | bool):
            problem = f"is {type(value).__name__}, expected str, int, float or bool"
            raise FileError(group.path, f"provenance {key!r} {problem}")
    return out


def _rate(file: CheckedGroup) -> float:
    rate: float = file.attribute("rate_hz", float)
    if rate <= 0:
        raise FileError(file.path, f"attribute 'rate_hz' is {rate}, expected a positive number")
    return rate
