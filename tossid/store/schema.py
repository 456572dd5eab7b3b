"""The dataset's schema `tossid.dataset/1`, and the checks that HDF5 itself does not make.

    /                 attributes: schema, source, rate_hz, frames, covariance_source, n_tosses, n_frames;
                      sessions (JSON, where the order of recording was looked at)
    /object           attributes: name, friction, restitution, width_m, nq, nv;
                      compliance, relaxation, cohesion (only where they are not 0)
    /object/mjcf      the object as MJCF text (UTF-8)
    /object/tags      a row a tag: id, body, size_m, T_body_tag (only where there are tags)
    /provenance       attributes: a flat dictionary, what the dataset was made from
    /tosses/NAME      attributes: index (its place), split ("" where none was drawn);
                      session, recorded_as (place in the order of recording), witnesses (what it says of it),
                      place_m (where it ends), turn and shift_m (T in levelled = T recorded: wxyz, and then up)
        t (n)  q (n, nq)  v (n, nv)  q_cov (n, nv, nv)  v_cov (n, nv, nv)  phase (n)
        q_measured (n, nq)  q_measured_cov (n, nv, nv)  (only where q was smoothed)

Each array carries its unit and frame as attributes. Why this schema:
docs/adr/0003-dataset-schema.md.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tossid import budget
from tossid.errors import FileError

SCHEMA = "tossid.dataset/1"
KNOWN_SCHEMAS = (SCHEMA,)

FRAMES = (
    "world: z up, ground z = 0; q = position of the base frame (world), quaternion wxyz (world from base), joints; "
    "v = linear velocity of the base frame's origin (world), angular velocity (body), joint rates; "
    "covariances in the tangent space of v's order, rotations perturbed on the right (body)"
)

# deflate cannot shrink data by more than 1032; a data set that declares more than
# its stored bytes could hold was not written by us
MAX_COMPRESSION = 1040
SMALL_CHUNK = 1 << 14
"""Stored bytes of a chunk up to which what it inflates to is not looked at: it is at most 16 MiB."""
MAX_ATTRIBUTE_TEXT = 32_000

# shuffle, deflate, Fletcher's checksum: HDF5 would load a plugin (code) for others
_CHECKSUM = 4
"""Bytes of Fletcher's checksum."""
_FILTERS = frozenset({h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_FLETCHER32})

CONTACT_LAW = ("compliance", "relaxation", "cohesion")
"""Attributes of an object that are absent where they are 0, as in files that are older than they."""
HEADERS = 1 << 20
"""Bytes of HDF5's headers, as they lie in the file, that stay in memory, where they take some ten times as much. HDF5's
own limit is 32 MiB."""

HINGE_MEANING = "link 2 in link 1 at angle zero: position, quaternion wxyz; in link 2: a point of the axis, the axis"
"""Of the array `/object/hinge` (13,) of two links of which nothing else is stated."""

TAG_DTYPE = np.dtype([("id", "<i8"), ("body", "<i8"), ("size_m", "<f8"), ("T_body_tag", "<f8", (4, 4))])


@dataclass(frozen=True, slots=True)
class Member:
    """One array of a toss.

    Attributes:
        name: Of the array, here and in `tossid.types.Toss`.
        shape: Names of its dimensions: "n", "nq" or "nv".
        dtype: Its type.
        unit: Its unit.
        meaning: What it is, and in which frame.
        optional: Whether it may be absent.
    """

    name: str
    shape: tuple[str, ...]
    dtype: str
    unit: str
    meaning: str
    optional: bool = False


MEMBERS = (
    Member("t", ("n",), "<f8", "s", "time"),
    Member("q", ("n", "nq"), "<f8", "m, 1, rad", "position, quaternion wxyz, joints"),
    Member("v", ("n", "nv"), "<f8", "m/s, rad/s, rad/s", "linear (world), angular (body), joint rates"),
    Member("q_cov", ("n", "nv", "nv"), "<f8", "(m, rad, rad)^2", "covariance of q: world, body, joints"),
    Member("v_cov", ("n", "nv", "nv"), "<f8", "(m/s, rad/s, rad/s)^2", "covariance of v: world, body, joints"),
    Member("phase", ("n",), "|u1", "1", "0 unknown, 1 flight, 2 impact, 3 slide, 4 roll, 5 rest"),
    Member("q_measured", ("n", "nq"), "<f8", "m, 1, rad", "the single poses that q was smoothed from", True),
    Member("q_measured_cov", ("n", "nv", "nv"), "<f8", "(m, rad, rad)^2", "covariance of q_measured", True),
)


def child(path: Path, group: h5py.Group, name: str, kind: type) -> Any:
    """The member `name` of a group, if it is there, in this file, and of the kind (h5py.Group or Dataset)."""
    link = group.get(name, getlink=True)
    word = "group" if kind is h5py.Group else "data set"
    where = f"{group.name.rstrip('/')}/{name}"
    if link is None:
        raise FileError(path, f"{word} {where} is missing")
    if not isinstance(link, h5py.HardLink):
        raise FileError(path, f"{where} is a link elsewhere, expected a {word} in the file itself")
    member = group[name]
    if not isinstance(member, kind):
        raise FileError(path, f"{where} is not a {word}")
    return member


def refuse_strangers(path: Path, group: h5py.Group, known: set[str]) -> None:
    """Raise `FileError` if a group has members that the schema does not name."""
    strange = sorted(set(group) - known)
    if strange:
        raise FileError(path, f"{group.name} holds {strange[0]!r}, which {SCHEMA} does not know")


def check_stored(
    path: Path, data: h5py.Dataset, dtype: np.dtype[Any], shape: tuple[int | None, ...], *, others: int = 0
) -> None:
    """Raise `FileError` unless a data set has the type and shape, and its bytes are in the file.

    Checked before anything is read: a damaged or hostile file may declare shapes that fill the memory, or filters and
    links that load other files.

    Args:
        path: The file, for the error.
        data: The data set.
        dtype: Its expected type.
        shape: Its expected shape; None where any length will do.
        others: Bytes of the arrays that are read with it, which may be links to the same one.
    """
    where = data.name
    if data.dtype != dtype:
        raise FileError(path, f"{where} has type {data.dtype}, expected {dtype}")
    fits = len(data.shape) == len(shape) and all(b is None or a == b for a, b in zip(data.shape, shape, strict=True))
    if not fits:
        want = ", ".join("n" if length is None else str(length) for length in shape)
        raise FileError(path, f"{where} has shape {data.shape}, expected ({want})")
    if data.is_virtual or data.external:
        raise FileError(path, f"{where} keeps its data in another file")
    plist = data.id.get_create_plist()
    listed = [plist.get_filter(k)[0] for k in range(plist.get_nfilters())]
    filters = set(listed)
    if not filters <= _FILTERS:
        raise FileError(path, f"{where} uses filter {min(filters - _FILTERS)}, which {SCHEMA} does not know")
    if len(listed) > len(filters):
        raise FileError(path, f"{where} uses a filter twice, which {SCHEMA} does not know")
    declared = math.prod(data.shape) * data.dtype.itemsize
    stored = data.id.get_storage_size()
    if declared > stored * MAX_COMPRESSION:
        raise FileError(path, f"{where} declares {declared} bytes, more than its {stored} stored bytes can hold")
    what = f"bytes of tosses, up to {where}" if others else f"bytes of {where}"
    budget.check_unpacked(path, others + declared, what=what)
    if data.chunks is not None:
        chunk = math.prod(data.chunks) * data.dtype.itemsize
        budget.check_unpacked(path, chunk, what=f"bytes of a chunk of {where}")
        if h5py.h5z.FILTER_DEFLATE in filters:
            _check_inflated(path, data, chunk)


def _check_inflated(path: Path, data: h5py.Dataset, chunk: int) -> None:
    """Refuse a data set with a chunk that inflates to more than its size: HDF5 makes room for all that comes."""
    large: list[tuple[int, ...]] = []

    def note(info: Any) -> None:
        if info.size > SMALL_CHUNK:
            large.append(info.chunk_offset)

    data.id.chunk_iter(note)
    for offset in large:
        mask, content = data.id.read_direct_chunk(offset)
        if mask:
            raise FileError(path, f"{data.name} has a chunk with filters of its own, which {SCHEMA} does not know")
        try:
            inflated = len(zlib.decompressobj().decompress(content, chunk + _CHECKSUM + 1))
        except zlib.error as error:
            raise FileError(path, f"damaged: {data.name} cannot be inflated ({error})") from error
        if inflated > chunk + _CHECKSUM:
            raise FileError(path, f"{data.name} has a chunk that inflates to more than its {chunk} bytes")


def attribute(path: Path, holder: h5py.Group, name: str, kind: type) -> Any:
    """Attribute of a group as a Python str, int or float.

    Raises:
        FileError: it is missing, of another type or, for numbers, not finite.
    """
    if name not in holder.attrs:
        raise FileError(path, f"attribute {name!r} of {holder.name} is missing")
    value = plain(holder.attrs[name])
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if type(value) is not kind:
        raise FileError(
            path, f"attribute {name!r} of {holder.name} is {type(value).__name__}, expected {kind.__name__}"
        )
    if isinstance(value, float) and not math.isfinite(value):
        raise FileError(path, f"attribute {name!r} of {holder.name} is not finite")
    return value


def plain(value: Any) -> Any:
    """NumPy scalars as Python's own; everything else as it is."""
    return value.item() if isinstance(value, np.generic) else value


def frugal(file: h5py.File) -> h5py.File:
    """The file, with a cache of headers that does not grow beyond `HEADERS`."""
    config = file.id.get_mdc_config()
    config.set_initial_size = True
    config.initial_size = config.min_size = config.max_size = HEADERS
    config.incr_mode = config.flash_incr_mode = config.decr_mode = 0  # it stays as it is
    file.id.set_mdc_config(config)
    return file
