"""Tosses of one object to HDF5: written whole or not at all, and checked."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import h5py
import numpy as np

from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.objects.unstated import hinge_of
from tossid.outputs import output_stream
from tossid.store.hdf5 import frugal, plain
from tossid.store.object_text import text_of_model
from tossid.store.schema import (
    CONTACT_LAW,
    FRAMES,
    HINGE_MEANING,
    MAX_ATTRIBUTE_TEXT,
    MEMBERS,
    SCHEMA,
    TAG_DTYPE,
)
from tossid.store.sessions import write_order
from tossid.types import Phase, RecordingOrder, Toss

T = TypeVar("T")


@contextmanager
def dataset_writer(model: ObjectModel, path: Path) -> Iterator[DatasetWriter]:
    """Write tosses that come one by one, and never need to be in memory together, as one HDF5 file.

    The file appears whole, when the block ends, after `DatasetWriter.finish`, or not at all: what was there before
    stays until the new one is complete on the disk. Equal tosses give equal bytes.

    Args:
        model: The dataset's object.
        path: The file (.h5).

    Yields:
        What takes the tosses.

    Raises:
        InputError: The tosses break the schema (names, joints, provenance).
        ObjectError: The object cannot be described in MJCF.
        OutputError: The disk is full, or the file cannot be written there.
        RuntimeError: The block ended without `finish`; there is no file then.
    """
    if not isinstance(model, ObjectModel):
        raise InputError(f"the dataset's object is a {type(model).__name__}, expected an ObjectModel")
    text = text_of_model(model) if model.is_stated else None
    with output_stream(path) as stream:
        sink = _Sink(stream)
        try:
            with frugal(h5py.File(sink, "w", libver=("v110", "v110"))) as file:
                _write_object(file.create_group("object"), model, text)
                yield DatasetWriter(file, model, sink)
                if "schema" not in file.attrs:
                    raise RuntimeError(f"{path}: the block ended without DatasetWriter.finish")
        finally:
            sink.check()


class DatasetWriter:
    """Takes the tosses of one dataset, see `dataset_writer`."""

    def __init__(self, file: h5py.File, model: ObjectModel, sink: _Sink) -> None:
        self._model, self._sink = model, sink
        self._file, self._tosses = file, file.create_group("tosses")
        self._splits: dict[str, str] = {}
        self._n_frames = 0

    def add(self, toss: Toss) -> None:
        """Write the next toss.

        Args:
            toss: A toss of the dataset's object, under a name of its own.

        Raises:
            InputError: Its name is taken or none, or it is of another object.
            OSError: The disk is full.
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
        self,
        *,
        rate_hz: float,
        source: str,
        provenance: Mapping[str, Any],
        splits: Mapping[str, str] | None = None,
        order: RecordingOrder | None = None,
    ) -> None:
        """Write what may be known only after the last toss.

        Args:
            rate_hz: Frames a second.
            source: Which importer or simulator made the tosses.
            provenance: Where they come from: text, numbers and booleans by name.
            splits: Of tosses by name, where they differ from the tosses' own.
            order: The order of recording, where it was looked at.

        Raises:
            InputError: There was no toss, or rate or provenance are none, or there are too many sessions.
        """
        if not self._splits:
            raise InputError("the dataset has no tosses")
        if not (np.isfinite(rate_hz) and rate_hz > 0):
            raise InputError(f"the dataset's rate is {rate_hz} Hz, expected a positive number")
        _check_provenance(provenance)
        for name, split in (self._splits | dict(splits or {})).items():
            self._tosses[name].attrs["split"] = split
        file = self._file
        if order is not None:
            write_order(file, self._tosses, order)
        attributes = {
            "schema": SCHEMA,
            "source": source,
            "rate_hz": float(rate_hz),
            "frames": FRAMES,
            "covariance_source": str(provenance.get("covariance_source", "not stated")),
            "n_tosses": len(self._splits),
            "n_frames": self._n_frames,
        }
        for key, value in attributes.items():  # (in this order: equal datasets give equal bytes)
            file.attrs[key] = value
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
    """The stream that HDF5 writes to.

    HDF5 does not survive a full disk. So the first error is kept for `check`, and HDF5 sees success from then on, while
    nothing is written.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._error: OSError | None = None

    def check(self) -> None:
        """Raise the first error."""
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


def _check_provenance(provenance: Mapping[str, Any]) -> None:
    for key, value in provenance.items():
        if not isinstance(key, str) or not key or not isinstance(value, (str, int, float, bool, np.generic)):
            raise InputError(f"provenance {key!r} is a {type(value).__name__}, expected str, int, float or bool")
        if isinstance(value, str) and (len(value.encode()) > MAX_ATTRIBUTE_TEXT or "\x00" in value):
            raise InputError(f"provenance {key!r} is text that an attribute cannot hold ({len(value)} characters)")


def _write_object(group: h5py.Group, model: ObjectModel, text: str | None) -> None:
    """The object; text: its MJCF, None for one of which nothing is stated."""
    group.attrs["name"] = model.name
    if text is None:
        group.attrs["nq"], group.attrs["nv"] = model.nq, model.nv
        hinge = hinge_of(model)
        if hinge is not None:
            made = _put(group, "hinge", np.concatenate(hinge))
            made.attrs["unit"], made.attrs["meaning"] = "m, 1, m, 1", HINGE_MEANING
        return
    group.attrs["friction"], group.attrs["restitution"] = float(model.friction), float(model.restitution)
    for name in CONTACT_LAW:
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
