"""Checks of the schema on HDF5 files that were not written by us."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest

from tossid.errors import FileError
from tossid.store.schema import attribute, check_stored, child, frugal, plain, refuse_strangers

NAME = Path("strange.h5")
FLOAT = np.dtype("<f8")


@pytest.fixture
def file(tmp_path: Path) -> Iterator[h5py.File]:
    with h5py.File(tmp_path / "strange.h5", "w") as made:
        made.create_group("group")
        made["data"] = np.zeros((4, 3))
        made["elsewhere"] = h5py.ExternalLink("other.h5", "/data")
        made["soft"] = h5py.SoftLink("/data")
        yield made


@pytest.mark.parametrize(
    ("name", "kind", "says"),
    [
        ("gone", h5py.Group, "group /gone is missing"),
        ("data", h5py.Group, "/data is not a group"),
        ("group", h5py.Dataset, "/group is not a data set"),
        ("soft", h5py.Dataset, "is a link elsewhere"),
        ("elsewhere", h5py.Dataset, "is a link elsewhere"),
    ],
)
def test_a_member_must_be_in_the_file_itself(file: h5py.File, name: str, kind: type, says: str) -> None:
    with pytest.raises(FileError, match=says):
        child(NAME, file, name, kind)
    assert child(NAME, file, "data", h5py.Dataset).shape == (4, 3)


def test_members_that_the_schema_does_not_name_are_refused(file: h5py.File) -> None:
    refuse_strangers(NAME, file, {"group", "data", "elsewhere", "soft", "absent"})
    with pytest.raises(FileError, match="holds 'elsewhere'"):
        refuse_strangers(NAME, file, {"group", "data", "soft"})


def test_type_and_shape_are_checked_before_anything_is_read(file: h5py.File) -> None:
    check_stored(Path(file.filename), file["data"], FLOAT, (None, 3))
    with pytest.raises(FileError, match=r"has shape \(4, 3\), expected \(n, 7\)"):
        check_stored(Path(file.filename), file["data"], FLOAT, (None, 7))
    with pytest.raises(FileError, match="has type float64, expected uint8"):
        check_stored(Path(file.filename), file["data"], np.dtype("u1"), (4, 3))


def test_bytes_that_are_not_in_the_file_are_refused(file: h5py.File) -> None:
    file.create_dataset("empty", shape=(1 << 20,), dtype=FLOAT, chunks=(1024,))
    with pytest.raises(FileError, match="more than its 0 stored bytes can hold"):
        check_stored(Path(file.filename), file["empty"], FLOAT, (None,))
    file.create_dataset("apart", shape=(4,), dtype=FLOAT, external=[("raw.bin", 0, 32)])
    with pytest.raises(FileError, match="keeps its data in another file"):
        check_stored(Path(file.filename), file["apart"], FLOAT, (None,))
    file.create_dataset("packed", data=np.zeros(64), chunks=(64,), scaleoffset=3)
    with pytest.raises(FileError, match="uses filter"):
        check_stored(Path(file.filename), file["packed"], FLOAT, (None,))


def test_attributes_are_python_values_of_the_right_type(file: h5py.File) -> None:
    file.attrs.update({"whole": 3, "rate": 148.0, "bad": np.nan, "text": "cube"})
    assert attribute(NAME, file, "rate", float) == 148.0
    assert attribute(NAME, file, "whole", float) == 3.0
    assert type(attribute(NAME, file, "whole", int)) is int
    for name, kind, says in (
        ("gone", str, "'gone' of / is missing"),
        ("text", float, "is str, expected float"),
        ("rate", int, "is float, expected int"),
        ("bad", float, "is not finite"),
    ):
        with pytest.raises(FileError, match=says):
            attribute(NAME, file, name, kind)
    assert plain("text") == "text"


def test_the_cache_of_headers_does_not_grow(file: h5py.File) -> None:
    config = frugal(file).id.get_mdc_config()
    assert config.min_size == config.max_size == 1 << 20
