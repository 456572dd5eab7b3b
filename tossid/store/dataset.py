"""Datasets in HDF5: written whole or not at all, checked on writing and on reading."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import h5py
import numpy as np

from tossid.errors import FileError, InputError, MotionError, ObjectError
from tossid.objects import ObjectModel
from tossid.store.atomic import whole_file
from tossid.store.hashing import file_sha256
from tossid.store.heaps import check_heaps
from tossid.store.object_text import model_of_text, text_of_model
from tossid.store.schema import (
    FRAMES,
    KNOWN_SCHEMAS,
    MAX_ATTRIBUTE_TEXT,
    MAX_TEXT,
    MEMBERS,
    SCHEMA,
    TAG_DTYPE,
    attribute,
    check_stored,
    child,
    plain,
    refuse_strangers,
)
from tossid.types import Dataset, OnDemand, Phase, Toss

T = TypeVar("T")

_ROOT = {"object", "provenance", "tosses"}
_UNKNOWN_SOURCE = "not stated"
_CONTACT_LAW = ("compliance", "relaxation", "cohesion")  # of an object; absent where 0, as in files older than they
KEPT = 256
"""Tosses of an open dataset that stay in memory."""
HEADERS = 1 << 20
"""Bytes of HDF5's headers, as they lie in the file, that stay in memory, where they take some ten times as much; HDF5's
own limit is 32 MiB."""


def write_dataset(dataset: Dataset, path: Path) -> None:
    """Write a dataset as one HDF5 file (schema: `tossid.store.schema`).

    The file appears whole or not at all: what was there before stays until the
    new one is complete on the disk. Equal datasets give equal bytes. Where the
    covariances come from is the provenance's `covariance_source`.

    Raises:
        InputError: the dataset breaks the schema (names, joints, provenance).
        ObjectError: the object cannot be said in MJCF.
        OutputError: the disk is full or the place cannot be written.
    """
    with dataset_writer(dataset.object, path) as writer:
        for toss in dataset.tosses:
            writer.add(toss)
        writer.finish(rate_hz=dataset.rate_hz, source=dataset.source, provenance=dataset.provenance)


@contextmanager
def dataset_writer(model: ObjectModel, path: Path) -> Iterator[DatasetWriter]:
    """`write_dataset` of tosses that come one by one, and never need to be in memory together.

    The file appears when the block ends, after `DatasetWriter.finish`.

    Raises:
        InputError, ObjectError, OutputError: as `write_dataset`.
        RuntimeError: the block ended without `finish`; there is no file then.
    """
    if not isinstance(model, ObjectModel):
        raise InputError(f"the dataset's object is a {type(model).__name__}, expected an ObjectModel")
    text = text_of_model(model)
    with whole_file(path) as stream:
        sink = _Sink(stream)
        try:
            with _frugal(h5py.File(sink, "w", libver=("v110", "v110"))) as file:
                _write_object(file.create_group("object"), model, text)
                yield DatasetWriter(file, model, sink)
                if "schema" not in file.attrs:
                    raise RuntimeError(f"{path}: the block ended without DatasetWriter.finish")
        finally:
            sink.check()


class DatasetWriter:
    """See `dataset_writer`."""

    def __init__(self, file: h5py.File, model: ObjectModel, sink: _Sink) -> None:
        self._model, self._sink = model, sink
        self._file, self._tosses = file, file.create_group("tosses")
        self._splits: dict[str, str] = {}
        self._n_frames = 0

    def add(self, toss: Toss) -> None:
        """Write the next toss.

        Raises:
            InputError: its name is taken or none, or it is of another object.
            OSError: the disk is full.
        """
        self._check(toss)
        into = self._tosses.create_group(toss.name)
        into.attrs["index"] = len(self._splits)
        for member in MEMBERS:
            value = getattr(toss, member.name)
            if value is None:
                continue
            made = _put(into, member.name, np.ascontiguousarray(value, dtype=member.dtype))
            made.attrs["unit"], made.attrs["meaning"] = member.unit, member.meaning
        self._splits[toss.name] = toss.split
        self._n_frames += len(toss)
        self._sink.check()

    def finish(
        self, *, rate_hz: float, source: str, provenance: Mapping[str, Any], splits: Mapping[str, str] | None = None
    ) -> None:
        """Write what may be known only after the last toss.

        Args:
            splits: of tosses by name, where they differ from the tosses' own.

        Raises:
            InputError: there was no toss, or rate or provenance are none.
        """
        if not self._splits:
            raise InputError("the dataset has no tosses")
        if not (np.isfinite(rate_hz) and rate_hz > 0):
            raise InputError(f"the dataset's rate is {rate_hz} Hz, expected a positive number")
        _check_provenance(provenance)
        for name, split in (self._splits | dict(splits or {})).items():
            self._tosses[name].attrs["split"] = split
        file = self._file
        file.attrs["schema"] = SCHEMA
        file.attrs["source"] = source
        file.attrs["rate_hz"] = float(rate_hz)
        file.attrs["frames"] = FRAMES
        file.attrs["covariance_source"] = str(provenance.get("covariance_source", _UNKNOWN_SOURCE))
        file.attrs["n_tosses"] = len(self._splits)
        file.attrs["n_frames"] = self._n_frames
        group = file.create_group("provenance")
        for key, value in sorted(provenance.items()):
            group.attrs[key] = plain(value)

    def _check(self, toss: Toss) -> None:
        model = self._model
        if not toss.name or "/" in toss.name or "\x00" in toss.name or toss.name in (".", ".."):
            raise InputError(f"a toss cannot be named {toss.name!r} (empty, a dot, or with '/')")
        if toss.name in self._splits:
            raise InputError(f"two tosses are named {toss.name!r}")
        if toss.q.shape[1] != model.nq:
            raise InputError(
                f"toss {toss.name} has {toss.q.shape[1] - 7} joints, object '{model.name}' has {model.n_joints}"
            )
        if toss.phase.max() > max(Phase):
            raise InputError(f"toss {toss.name} has phase {toss.phase.max()}, expected at most {max(Phase)}")


class _Sink:
    """The stream that HDF5 writes to. HDF5 does not survive a full disk, so it is never told: the first error is kept
    for `check`, and nothing is written from then on."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._error: OSError | None = None

    def check(self) -> None:
        if self._error is not None:
            raise self._error

    def read(self, size: int = -1) -> bytes:
        return self._tried(lambda: self._stream.read(size), bytes(max(0, size)))

    def write(self, data: bytes) -> int:
        return self._tried(lambda: self._stream.write(data), len(data))

    def seek(self, place: int, whence: int = 0) -> int:
        return self._tried(lambda: self._stream.seek(place, whence), place)

    def tell(self) -> int:
        return self._tried(self._stream.tell, 0)

    def truncate(self, size: int | None = None) -> int:
        return self._tried(lambda: self._stream.truncate(size), size or 0)

    def flush(self) -> None:
        self._tried(self._stream.flush, None)

    def _tried(self, do: Callable[[], T], otherwise: T) -> T:
        if self._error is None:
            try:
                return do()
            except OSError as error:
                self._error = error
        return otherwise


def read_dataset(path: Path) -> Dataset:
    """Read a dataset that `write_dataset` or another program wrote in its schema.

    Raises:
        FileError: missing, damaged, of an unknown schema, or holding what is no
            motion; the error names the file and the group.
    """
    with open_dataset(path) as dataset:
        return replace(dataset, tosses=tuple(dataset.tosses))


@contextmanager
def open_dataset(path: Path, *, split: str | None = None) -> Iterator[Dataset]:
    """A dataset whose tosses are read when they are asked for, while the block lasts; a few stay in memory.

    Args:
        split: only its tosses; None for all.

    Raises:
        FileError: as `read_dataset`; what is wrong with a toss, when it is read.
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

        def read(i: int) -> Toss:
            with _explained(path):
                return _read_toss(path, file["tosses"][names[i]], model)

        yield Dataset(model, OnDemand(read, len(names), kept=KEPT), rate_hz, source, provenance)


def _read_toss(path: Path, group: h5py.Group, model: ObjectModel) -> Toss:
    refuse_strangers(path, group, {member.name for member in MEMBERS})
    arrays = {member: data[()] for member, data in _checked_members(path, group, model.nq, model.nv)}
    try:
        toss = Toss(name=group.name.rsplit("/", 1)[1], split=attribute(path, group, "split", str), **arrays)
    except MotionError as error:
        row = None if error.row is None else f"{group.name}, frame {error.row}"
        raise FileError(path, error.problem, row=row or group.name) from error
    if toss.phase.max() > max(Phase):
        raise FileError(path, f"{group.name}/phase holds {toss.phase.max()}, expected at most {max(Phase)}")
    return toss


def dataset_info(path: Path) -> dict[str, Any]:
    """What is in a dataset, without reading its motions.

    Returns:
        schema, object, n_joints, n_tosses, n_frames, rate_hz, duration_s, source,
        covariance_source, splits (tosses a split), phases (frames a phase),
        provenance, sha256 (of the file).

    Raises:
        FileError: as `read_dataset`, for what is looked at.
    """
    path = Path(path)
    with _opened(path) as file, _explained(path):
        _check_root(path, file)
        model = child(path, file, "object", h5py.Group)
        nq, nv = attribute(path, model, "nq", int), attribute(path, model, "nv", int)
        splits: Counter[str] = Counter()
        phases = np.zeros(max(Phase) + 1, dtype=int)
        n_tosses, n_frames, duration = 0, 0, 0.0
        for name in _toss_names(path, file):
            group = child(path, file["tosses"], name, h5py.Group)
            data = dict(_checked_members(path, group, nq, nv))
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
            "provenance": _read_provenance(path, child(path, file, "provenance", h5py.Group)),
            "sha256": file_sha256(path),
        }


def _check_provenance(provenance: Mapping[str, Any]) -> None:
    for key, value in provenance.items():
        if not isinstance(key, str) or not key or not isinstance(value, (str, int, float, bool, np.generic)):
            raise InputError(f"provenance {key!r} is a {type(value).__name__}, expected str, int, float or bool")
        if isinstance(value, str) and (len(value.encode()) > MAX_ATTRIBUTE_TEXT or "\x00" in value):
            raise InputError(f"provenance {key!r} is text that an attribute cannot hold ({len(value)} characters)")


def _write_object(group: h5py.Group, model: ObjectModel, text: str) -> None:
    group.attrs["name"] = model.name
    group.attrs["friction"], group.attrs["restitution"] = float(model.friction), float(model.restitution)
    for name in _CONTACT_LAW:
        if getattr(model, name):
            group.attrs[name] = float(getattr(model, name))
    group.attrs["width_m"] = float(model.width)
    group.attrs["nq"], group.attrs["nv"] = model.nq, model.nv
    _put(group, "mjcf", np.frombuffer(text.encode(), dtype="|u1")).attrs["encoding"] = "UTF-8 text"
    if model.tags:
        rows = [(tag.id, tag.body, tag.size, tag.T_body_tag) for tag in model.tags]
        _put(group, "tags", np.array(rows, dtype=TAG_DTYPE))


def _put(group: h5py.Group, name: str, data: np.ndarray) -> h5py.Dataset:
    """A compressed array: deflate ends with a checksum, so that no damaged array is read."""
    return group.create_dataset(name, data=data, compression="gzip", compression_opts=4, shuffle=True)


def _frugal(file: h5py.File) -> h5py.File:
    """The file, with a cache of headers that does not grow beyond `HEADERS`."""
    config = file.id.get_mdc_config()
    config.set_initial_size = True
    config.initial_size = config.min_size = config.max_size = HEADERS
    config.incr_mode = config.flash_incr_mode = config.decr_mode = 0  # it stays as it is
    file.id.set_mdc_config(config)
    return file


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """The file, for reading; `_explained` should be around what is read of it."""
    if not path.is_file():
        raise FileError(path, "no such dataset file")
    with _explained(path):
        check_heaps(path)
        file = _frugal(h5py.File(path, "r", locking="best-effort"))
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


def _checked_members(path: Path, group: h5py.Group, nq: int, nv: int) -> Iterator[tuple[str, h5py.Dataset]]:
    sizes: dict[str, int | None] = {"n": None, "nq": nq, "nv": nv}
    for member in MEMBERS:
        if member.optional and member.name not in group:
            continue
        data = child(path, group, member.name, h5py.Dataset)
        check_stored(path, data, np.dtype(member.dtype), tuple(sizes[name] for name in member.shape))
        if sizes["n"] is None:
            sizes["n"] = data.shape[0]
            if data.shape[0] < 2:
                raise FileError(path, f"{group.name} has {data.shape[0]} frames, expected at least 2")
        yield member.name, data


def _read_object(path: Path, group: h5py.Group) -> ObjectModel:
    refuse_strangers(path, group, {"mjcf", "tags"})
    stored = child(path, group, "mjcf", h5py.Dataset)
    check_stored(path, stored, np.dtype("|u1"), (None,))
    if stored.shape[0] > MAX_TEXT:
        raise FileError(path, f"/object/mjcf holds {stored.shape[0]} bytes, expected at most {MAX_TEXT}")
    text = stored[()].tobytes().decode()
    tags = None
    if "tags" in group:
        data = child(path, group, "tags", h5py.Dataset)
        check_stored(path, data, TAG_DTYPE, (None,))
        tags = data[()]
    try:
        model = model_of_text(
            text,
            name=attribute(path, group, "name", str),
            friction=attribute(path, group, "friction", float),
            restitution=attribute(path, group, "restitution", float),
            **{name: attribute(path, group, name, float) if name in group.attrs else 0.0 for name in _CONTACT_LAW},
            width=attribute(path, group, "width_m", float),
            tags=tags,
        )
    except ObjectError as error:
        raise FileError(path, f"/object: {error}") from error
    if (model.nq, model.nv) != (attribute(path, group, "nq", int), attribute(path, group, "nv", int)):
        raise FileError(path, f"/object/mjcf has {model.n_joints} joints, the attributes nq and nv say otherwise")
    return model


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
