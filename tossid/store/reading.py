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
from tossid.store.heaps import check_heaps
from tossid.store.object_text import model_of_text
from tossid.store.schema import (
    CONTACT_LAW,
    KNOWN_SCHEMAS,
    MEMBERS,
    TAG_DTYPE,
    attribute,
    check_stored,
    child,
    frugal,
    plain,
    refuse_strangers,
)
from tossid.store.sessions import read_order, sessions_info
from tossid.types import OnDemand, Phase, Toss

_ROOT = {"object", "provenance", "tosses"}
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
    with _opened(path) as file:
        with _explained(path):
            _check_root(path, file)
            model = _read_object(path, child(path, file, "object", h5py.Group))
            names = [
                name
                for name in _toss_names(path, file)
                if split in (None, attribute(path, file["tosses"][name], "split", str))
            ]
            rate_hz, source = _positive(path, file, "rate_hz"), attribute(path, file, "source", str)
            provenance = _read_provenance(path, child(path, file, "provenance", h5py.Group))
            order = read_order(path, file, file["tosses"], names)

        claimed: dict[int, int] = {}  # bytes of each toss that was read
        total = 0

        def read(i: int) -> Toss:
            nonlocal total
            with _explained(path):
                others = total - claimed.get(i, 0)
                toss, claimed[i] = _read_toss(path, file["tosses"][names[i]], model, others)
                total = others + claimed[i]
                return toss

        yield Dataset(model, OnDemand(read, len(names), kept=KEPT), rate_hz, source, provenance, order=order)


def _read_toss(path: Path, group: h5py.Group, model: ObjectModel, others: int) -> tuple[Toss, int]:
    """A toss and its bytes; others: bytes of the tosses that were read of the file."""
    refuse_strangers(path, group, {member.name for member in MEMBERS})
    arrays, claimed = {}, 0
    for member, data in _checked_members(path, group, model.nq, model.nv, others):
        claimed += data.nbytes
        arrays[member] = data[()]
    try:
        toss = Toss(name=group.name.rsplit("/", 1)[1], split=attribute(path, group, "split", str), **arrays)
    except MotionError as error:
        row = None if error.row is None else f"{group.name}, frame {error.row}"
        raise FileError(path, error.problem, row=row or group.name) from error
    if toss.phase.max() > max(Phase):
        raise FileError(path, f"{group.name}/phase holds {toss.phase.max()}, expected at most {max(Phase)}")
    return toss, claimed


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
    with _opened(path) as file, _explained(path):
        _check_root(path, file)
        model = child(path, file, "object", h5py.Group)
        nq, nv = attribute(path, model, "nq", int), attribute(path, model, "nv", int)
        splits: Counter[str] = Counter()
        phases = np.zeros(max(Phase) + 1, dtype=int)
        n_tosses, n_frames, duration, claimed = 0, 0, 0.0, 0
        names = _toss_names(path, file)
        for name in names:
            group = child(path, file["tosses"], name, h5py.Group)
            data = dict(_checked_members(path, group, nq, nv, claimed))
            claimed += sum(array.nbytes for array in data.values())
            phase = data["phase"][()]
            if phase.max() > max(Phase):
                raise FileError(path, f"{group.name}/phase holds {phase.max()}, expected at most {max(Phase)}")
            phases += np.bincount(phase, minlength=len(phases))
            splits[attribute(path, group, "split", str)] += 1
            n_tosses += 1
            n_frames += len(phase)
            duration += float(data["t"][-1] - data["t"][0])
        return {
            "schema": attribute(path, file, "schema", str),
            "object": attribute(path, model, "name", str),
            "n_joints": nv - 6,
            "n_tosses": n_tosses,
            "n_frames": n_frames,
            "rate_hz": _positive(path, file, "rate_hz"),
            "duration_s": duration,
            "source": attribute(path, file, "source", str),
            "covariance_source": attribute(path, file, "covariance_source", str),
            "splits": {name or "none": count for name, count in sorted(splits.items())},
            "phases": {phase.name.lower(): int(phases[phase]) for phase in Phase if phases[phase]},
            "sessions": sessions_info(path, file, names),
            "provenance": _read_provenance(path, child(path, file, "provenance", h5py.Group)),
            "sha256": file_sha256(path),
        }


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """The file, for reading; `_explained` should be around what is read of it."""
    if not path.is_file():
        raise FileError(path, "no such dataset file")
    with _explained(path):
        check_heaps(path)
        file = frugal(h5py.File(path, "r", locking="best-effort"))
    with file:
        yield file


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Whatever HDF5 finds wrong with a file becomes one `FileError`."""
    try:
        yield
    except FileError:
        raise
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError, UnicodeError) as error:
        first = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise FileError(path, f"damaged, or not an HDF5 file ({first})") from error


def _check_root(path: Path, file: h5py.File) -> None:
    known = ", ".join(KNOWN_SCHEMAS)
    if "schema" not in file.attrs:
        raise FileError(path, f"an HDF5 file without a schema, expected {known}")
    schema = attribute(path, file, "schema", str)
    if schema not in KNOWN_SCHEMAS:
        raise FileError(path, f"schema {schema!r} is unknown; this version of tossid reads {known}")
    refuse_strangers(path, file, _ROOT)


def _toss_names(path: Path, file: h5py.File) -> list[str]:
    """The tosses' names, in their order."""
    tosses = child(path, file, "tosses", h5py.Group)
    names = list(tosses)
    places = [attribute(path, child(path, tosses, name, h5py.Group), "index", int) for name in names]
    if sorted(places) != list(range(len(names))):
        raise FileError(path, "the tosses' index attributes are not 0, 1, 2, …")
    if len(names) != attribute(path, file, "n_tosses", int) or not names:
        raise FileError(path, f"/tosses holds {len(names)} tosses, n_tosses says {plain(file.attrs['n_tosses'])}")
    return [name for _, name in sorted(zip(places, names, strict=True))]


def _checked_members(
    path: Path, group: h5py.Group, nq: int, nv: int, others: int
) -> Iterator[tuple[str, h5py.Dataset]]:
    """The arrays of a toss, each checked; others: bytes of tosses before it, which may be links to the same arrays."""
    sizes: dict[str, int | None] = {"n": None, "nq": nq, "nv": nv}
    for member in MEMBERS:
        if member.optional and member.name not in group:
            continue
        data = child(path, group, member.name, h5py.Dataset)
        shape = tuple(sizes[name] for name in member.shape)
        check_stored(path, data, np.dtype(member.dtype), shape, others=others)
        others += data.nbytes
        if sizes["n"] is None:
            sizes["n"] = data.shape[0]
            if data.shape[0] < 2:
                raise FileError(path, f"{group.name} has {data.shape[0]} frames, expected at least 2")
        yield member.name, data


def _read_object(path: Path, group: h5py.Group) -> ObjectModel:
    refuse_strangers(path, group, {"mjcf", "tags", "hinge"})
    if set(group) <= {"hinge"} and attribute(path, group, "name", str) == UNKNOWN:
        unstated = unstated_object(hinge=_read_hinge(path, group) if "hinge" in group else None)
        if (attribute(path, group, "nq", int), attribute(path, group, "nv", int)) != (unstated.nq, unstated.nv):
            raise FileError(
                path, f"/object is '{UNKNOWN}' with {unstated.n_joints} hinges; the attributes nq and nv say otherwise"
            )
        return unstated
    stored = child(path, group, "mjcf", h5py.Dataset)
    check_stored(path, stored, np.dtype("|u1"), (None,))
    budget.check_claim(path, "bytes of /object/mjcf", stored.shape[0], budget.limits().model_text)
    text = stored[()].tobytes().decode()
    tags = None
    if "tags" in group:
        data = child(path, group, "tags", h5py.Dataset)
        check_stored(path, data, TAG_DTYPE, (None,))
        budget.check_claim(path, "tags", data.shape[0], budget.limits().tags)
        tags = data[()]
    try:
        model = model_of_text(
            text,
            name=attribute(path, group, "name", str),
            friction=attribute(path, group, "friction", float),
            restitution=attribute(path, group, "restitution", float),
            **{name: attribute(path, group, name, float) if name in group.attrs else 0.0 for name in CONTACT_LAW},
            width=attribute(path, group, "width_m", float),
            tags=tags,
        )
    except ObjectError as error:
        raise FileError(path, f"/object: {error}") from error
    if (model.nq, model.nv) != (attribute(path, group, "nq", int), attribute(path, group, "nv", int)):
        raise FileError(path, f"/object/mjcf has {model.n_joints} joints, the attributes nq and nv say otherwise")
    return model


def _read_hinge(path: Path, group: h5py.Group) -> Hinge:
    data = child(path, group, "hinge", h5py.Dataset)
    check_stored(path, data, np.dtype("<f8"), (13,))
    values = data[()]
    hinge = Hinge(*np.split(values, [3, 7, 10]))
    unit = all(abs(np.linalg.norm(part) - 1) < 1e-6 for part in (hinge.body_quat, hinge.axis))
    if not np.isfinite(values).all() or not unit:
        raise FileError(path, "/object/hinge is no hinge: not finite, or its quaternion or axis is not of length 1")
    return hinge


def _read_provenance(path: Path, group: h5py.Group) -> dict[str, Any]:
    refuse_strangers(path, group, set())
    out = {}
    for key in sorted(group.attrs):
        value = plain(group.attrs[key])
        if not isinstance(value, (str, int, float, bool)):
            raise FileError(path, f"provenance {key!r} is {type(value).__name__}, expected str, int, float or bool")
        out[key] = value
    return out


def _positive(path: Path, file: h5py.File, name: str) -> float:
    value: float = attribute(path, file, name, float)
    if value <= 0:
        raise FileError(path, f"attribute {name!r} is {value}, expected a positive number")
    return value
