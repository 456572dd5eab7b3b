"""A dataset is read as it was written; what is damaged, hostile or unfinished is one clear error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from tests.store.makers import assert_same
from tossid.errors import FileError
from tossid.store import (
    SCHEMA,
    Dataset,
    dataset_info,
    file_sha256,
    open_dataset,
    read_dataset,
)
from tossid.types import Phase


def test_tosses_are_read_when_they_are_asked_for(dataset: Dataset, path: Path) -> None:
    spoilt = dataset.tosses[2]
    with h5py.File(path, "a") as file:
        file[f"tosses/{spoilt.name}/t"][3] = np.nan
    with open_dataset(path) as opened:
        assert len(opened.tosses) == 4
        assert_same(replace(dataset, tosses=dataset.tosses[:2]), replace(opened, tosses=opened.tosses[:2]))
        with pytest.raises(FileError, match=f"{spoilt.name}, frame 3: time is not finite"):
            opened.tosses[2]
        with pytest.raises(ValueError, match="mine"):  # what goes wrong in the block is not the file's fault
            raise ValueError("mine")
    with open_dataset(path, split="validation") as opened:
        assert [toss.name for toss in opened.tosses] == ["toss_0001"]
    with open_dataset(path, split="") as opened:
        assert not opened.tosses


def test_bare_h5py_reads_it(dataset: Dataset, path: Path) -> None:
    with h5py.File(path) as file:
        assert file.attrs["schema"] == SCHEMA
        assert file.attrs["rate_hz"] == 148.0
        assert "quaternion wxyz" in file.attrs["frames"]
        assert file["object/mjcf"][()].tobytes().decode() == dataset.object.mjcf
        toss = file["tosses/toss_0002"]
        np.testing.assert_array_equal(toss["q"], dataset.tosses[2].q)
        assert toss["v"].attrs["unit"] == "m/s, rad/s, rad/s"
        assert toss.attrs["split"] == "test"


def test_info_counts(dataset: Dataset, path: Path) -> None:
    info = dataset_info(path)
    phases = np.concatenate([toss.phase for toss in dataset.tosses])
    assert info["schema"] == SCHEMA
    assert info["object"] == "cube"
    assert info["n_tosses"] == 4
    assert info["n_frames"] == 12 + 13 + 14 + 15
    assert info["rate_hz"] == 148.0
    assert info["source"] == "test"
    assert info["sha256"] == file_sha256(path)
    assert info["splits"] == {"train": 2, "validation": 1, "test": 1}
    assert info["phases"]["flight"] == (phases == Phase.FLIGHT).sum()
    assert info["duration_s"] == pytest.approx((54 - 4) / 148)
    assert info["provenance"] == dataset.provenance
    assert info["covariance_source"] == "made up"


def refused(path: Path, *says: str) -> None:
    """Reading is one FileError that names the file, as info is or goes through."""
    with pytest.raises(FileError) as caught:
        read_dataset(path)
    message = str(caught.value)
    assert "\n" not in message
    assert path.name in message
    for words in says:
        assert words in message


@pytest.mark.parametrize("share", [0.0, 0.001, 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 0.999])
def test_a_truncated_file_is_refused(path: Path, share: float) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    refused(path)
    with pytest.raises(FileError):
        dataset_info(path)


def test_flipped_bytes_are_never_read_as_data(dataset: Dataset, path: Path) -> None:
    """Every array carries a checksum: a flipped byte is an error, or it was none of the data's."""
    content = path.read_bytes()
    rng = np.random.default_rng(0)
    caught = 0
    for place in rng.integers(0, len(content), size=60):
        damaged = bytearray(content)
        damaged[place] ^= 0xFF
        path.write_bytes(damaged)
        try:
            again = read_dataset(path)
        except FileError:
            caught += 1
            continue
        for x, y in zip(dataset.tosses, again.tosses, strict=True):
            np.testing.assert_array_equal(x.q_cov, y.q_cov)
            np.testing.assert_array_equal(x.q, y.q)
    assert caught > 20


def test_what_is_no_dataset_is_refused(tmp_path: Path) -> None:
    refused(tmp_path / "missing.h5", "no such dataset")
    (tmp_path / "text.h5").write_text("not HDF5 at all")
    refused(tmp_path / "text.h5", "not an HDF5 file")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = 1
    refused(tmp_path / "other.h5", "without a schema", SCHEMA)
    refused(tmp_path, "no such dataset")


def edit(path: Path, change: Callable[[h5py.File], None]) -> None:
    with h5py.File(path, "r+") as file:
        change(file)


def put(name: str, data: object) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        del file[name]
        file[name] = data

    return change


def set_attribute(holder: str, name: str, value: object) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        file[holder].attrs[name] = value

    return change


def drop(name: str) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        del file[name]

    return change


def huge(file: h5py.File) -> None:
    del file["tosses/toss_0000/t"]
    file["tosses/toss_0000"].create_dataset("t", shape=(10**12,), dtype="<f8", chunks=(1024,))


def hollow(file: h5py.File) -> None:
    """A shape that would fit into memory, without a byte behind it."""
    del file["tosses/toss_0000/t"]
    file["tosses/toss_0000"].create_dataset("t", shape=(10**8,), dtype="<f8", chunks=(1024,))


def virtual(file: h5py.File) -> None:
    del file["tosses/toss_0000/t"]
    layout = h5py.VirtualLayout(shape=(12,), dtype="<f8")
    layout[:] = h5py.VirtualSource("/etc/hostname", "t", shape=(12,))
    file["tosses/toss_0000"].create_virtual_dataset("t", layout)


def external(file: h5py.File) -> None:
    del file["tosses/toss_0000/t"]
    file["tosses/toss_0000"].create_dataset("t", shape=(12,), dtype="<f8", external=[("/etc/hostname", 0, 96)])


def nan_frame(file: h5py.File) -> None:
    file["tosses/toss_0001/q"][3, 0] = np.nan


def long_quaternion(file: h5py.File) -> None:
    file["tosses/toss_0001/q"][5, 3:7] *= 1.1


def backwards(file: h5py.File) -> None:
    file["tosses/toss_0001/t"][4] = 0.0


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (set_attribute("/", "schema", "tossid.dataset/99"), ["tossid.dataset/99", "unknown", SCHEMA]),
        (set_attribute("/", "schema", 1), ["schema"]),
        (set_attribute("/", "rate_hz", -1.0), ["rate_hz"]),
        (set_attribute("/", "rate_hz", "fast"), ["rate_hz", "expected float"]),
        (set_attribute("/", "n_tosses", 9), ["n_tosses"]),
        (set_attribute("/tosses/toss_0001", "index", 0), ["index"]),
        (set_attribute("/tosses/toss_0001", "split", "holdout"), ["/tosses/toss_0001", "holdout"]),
        (set_attribute("/object", "friction", float("nan")), ["friction"]),
        (set_attribute("/object", "friction", -0.1), ["/object", "friction"]),
        (set_attribute("/object", "compliance", -1e-5), ["/object", "compliance"]),
        (set_attribute("/object", "cohesion", float("inf")), ["cohesion"]),
        (set_attribute("/object", "nq", 8), ["joints"]),
        (set_attribute("/provenance", "array", np.zeros(3)), ["provenance", "array"]),
        (drop("/tosses"), ["/tosses is missing"]),
        (drop("/provenance"), ["/provenance is missing"]),
        (drop("/object/mjcf"), ["/object/mjcf is missing"]),
        (drop("/tosses/toss_0002/v_cov"), ["/tosses/toss_0002/v_cov is missing"]),
        (drop("/tosses/toss_0002"), ["index"]),
        (put("/tosses/toss_0000/q", np.zeros((12, 8))), ["/tosses/toss_0000/q", "shape (12, 8)", "(12, 7)"]),
        (put("/tosses/toss_0000/q", np.zeros((12, 7), dtype="<f4")), ["/tosses/toss_0000/q", "float32"]),
        (put("/tosses/toss_0000/q", "a string"), ["/tosses/toss_0000/q", "type"]),
        (put("/tosses/toss_0000/phase", np.full(12, 77, dtype=np.uint8)), ["phase", "77"]),
        (put("/object/mjcf", np.frombuffer(b"<mujoco", dtype="|u1")), ["not valid XML"]),
        (put("/object/mjcf", np.frombuffer(b"\xff\xfe", dtype="|u1")), ["damaged"]),
        (
            put("/object/mjcf", np.frombuffer(b'<mujoco><include file="/etc/passwd"/></mujoco>', dtype="|u1")),
            ["names another file"],
        ),
        (
            put("/object/mjcf", np.frombuffer(b"<mujoco><extension><plugin/></extension></mujoco>", dtype="|u1")),
            ["element <extension>"],
        ),
        (put("/tosses/toss_0000/t", h5py.ExternalLink("other.h5", "/t")), ["/tosses/toss_0000/t", "link"]),
        (put("/tosses/toss_0000/t", h5py.SoftLink("/tosses/toss_0000/q")), ["link"]),
        (put("/tosses/toss_0001", h5py.ExternalLink("other.h5", "/")), ["/tosses/toss_0001", "link"]),
        (lambda file: file.create_dataset("surprise", data=1), ["surprise"]),
        (lambda file: file["tosses/toss_0000"].create_group("more"), ["more"]),
        (huge, ["/tosses/toss_0000/t", "declares"]),
        (hollow, ["/tosses/toss_0000/t", "declares"]),
        (virtual, ["another file"]),
        (external, ["another file"]),
        (nan_frame, ["/tosses/toss_0001", "frame 3", "finite"]),
        (long_quaternion, ["/tosses/toss_0001", "frame 5", "norm 1.1"]),
        (backwards, ["/tosses/toss_0001", "frame 4", "increase"]),
    ],
)
def test_what_breaks_the_schema_is_not_read(path: Path, change: Callable[[h5py.File], None], says: list[str]) -> None:
    edit(path, change)
    refused(path, *says)


def test_a_foreign_filter_is_not_loaded(path: Path) -> None:
    def change(file: h5py.File) -> None:
        del file["tosses/toss_0000/t"]
        file["tosses/toss_0000"].create_dataset("t", data=np.arange(12) / 148, chunks=(12,), compression="lzf")

    edit(path, change)
    refused(path, "/tosses/toss_0000/t", "filter")
