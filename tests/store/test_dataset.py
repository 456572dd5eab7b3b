"""What is written is read back to the last bit; what is damaged, hostile or unfinished is one clear error."""

from __future__ import annotations

import errno
import os
import resource
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.physics.trees import random_tree
from tests.store.makers import make_dataset, make_toss
from tossid.errors import FileError, InputError, ObjectError, OutputError
from tossid.objects import ObjectModel, Tag
from tossid.store import (
    SCHEMA,
    dataset_info,
    dataset_writer,
    file_sha256,
    open_dataset,
    read_dataset,
    write_dataset,
)
from tossid.types import SPLITS, Dataset, Phase

ARRAYS = ("t", "q", "v", "q_cov", "v_cov", "phase")


def assert_same(a: Dataset, b: Dataset) -> None:
    assert (a.rate_hz, a.source, a.provenance) == (b.rate_hz, b.source, b.provenance)
    assert [type(x) for x in a.provenance.values()] == [type(b.provenance[key]) for key in a.provenance]
    assert [(toss.name, toss.split) for toss in a.tosses] == [(toss.name, toss.split) for toss in b.tosses]
    for x, y in zip(a.tosses, b.tosses, strict=True):
        for name in ARRAYS:
            np.testing.assert_array_equal(getattr(x, name), getattr(y, name))
            assert getattr(x, name).dtype == getattr(y, name).dtype


def assert_same_object(a: ObjectModel, b: ObjectModel) -> None:
    for name in ("name", "friction", "restitution", "compliance", "relaxation", "cohesion", "width"):
        assert getattr(a, name) == getattr(b, name), name
    for name in ("parent", "joint_type", "joint_pos", "joint_axis", "body_pos", "body_quat", "mass", "com", "inertia"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    np.testing.assert_array_equal(a.corner_body, b.corner_body)
    np.testing.assert_array_equal(a.corner_pos, b.corner_pos)
    assert len(a.tags) == len(b.tags)
    for x, y in zip(a.tags, b.tags, strict=True):
        assert (x.id, x.size, x.body) == (y.id, y.size, y.body)
        np.testing.assert_array_equal(x.T_body_tag, y.T_body_tag)


@pytest.fixture
def dataset(cube: ObjectModel) -> Dataset:
    return make_dataset(cube)


@pytest.fixture
def path(dataset: Dataset, tmp_path: Path) -> Path:
    write_dataset(dataset, tmp_path / "tosses.h5")
    return tmp_path / "tosses.h5"


# --- there and back ---


def test_measured_poses_stay_beside_smoothed_ones(dataset: Dataset, tmp_path: Path) -> None:
    smoothed = [replace(toss, q_measured=toss.q + 0.0, q_measured_cov=2 * toss.q_cov) for toss in dataset.tosses]
    given = replace(dataset, tosses=(dataset.tosses[0], *smoothed[1:]))
    write_dataset(given, tmp_path / "both.h5")
    again = read_dataset(tmp_path / "both.h5")
    assert again.tosses[0].q_measured is None
    assert again.tosses[0].measured[0] is again.tosses[0].q
    for before, after in zip(given.tosses[1:], again.tosses[1:], strict=True):
        np.testing.assert_array_equal(before.q_measured, after.q_measured)
        np.testing.assert_array_equal(before.q_measured_cov, after.measured[1])
    with h5py.File(tmp_path / "both.h5", "a") as file:
        del file[f"tosses/{given.tosses[1].name}/q_measured_cov"]
    with pytest.raises(FileError, match="come together"):
        read_dataset(tmp_path / "both.h5")


def test_a_dataset_survives(dataset: Dataset, path: Path) -> None:
    again = read_dataset(path)
    assert_same(dataset, again)
    assert_same_object(dataset.object, again.object)


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


def test_tosses_that_come_one_by_one_give_the_same_file(dataset: Dataset, path: Path, tmp_path: Path) -> None:
    rest = {"rate_hz": dataset.rate_hz, "source": dataset.source, "provenance": dataset.provenance}
    with dataset_writer(dataset.object, tmp_path / "a.h5") as writer:
        for toss in dataset.tosses:
            writer.add(replace(toss, split=""))
        assert not (tmp_path / "a.h5").exists()
        writer.finish(**rest, splits={toss.name: toss.split for toss in dataset.tosses})
    assert (tmp_path / "a.h5").read_bytes() == path.read_bytes()
    with (
        pytest.raises(InputError, match="two tosses are named"),
        dataset_writer(dataset.object, tmp_path / "b.h5") as writer,
    ):
        writer.add(dataset.tosses[0])
        writer.add(dataset.tosses[0])
    with (
        pytest.raises(RuntimeError, match=r"c\.h5: the block ended without"),
        dataset_writer(dataset.object, tmp_path / "c.h5") as writer,
    ):
        writer.add(dataset.tosses[0])
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.h5", "tosses.h5"]


def test_tags_and_values_that_mjcf_cannot_say_survive(cube: ObjectModel, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    tags = tuple(Tag(id=k, size=0.04 + k / 1000, body=0, T_body_tag=rng.normal(size=(4, 4))) for k in range(6))
    model = cube.with_changes(name="würfel", friction=0.31, restitution=0.12, width=0.2, tags=tags)
    write_dataset(make_dataset(model), tmp_path / "a.h5")
    assert_same_object(model, read_dataset(tmp_path / "a.h5").object)


def test_the_contact_law_survives_and_is_absent_where_it_is_rigid(cube: ObjectModel, tmp_path: Path) -> None:
    law = {"compliance": 3e-5, "relaxation": 2e-3, "cohesion": 0.07}
    model = cube.with_changes(**law)
    for name, written in (("a", model), ("b", cube)):
        write_dataset(make_dataset(written), tmp_path / f"{name}.h5")
        assert_same_object(written, read_dataset(tmp_path / f"{name}.h5").object)
    with h5py.File(tmp_path / "a.h5") as soft, h5py.File(tmp_path / "b.h5") as rigid:
        assert {name: soft["object"].attrs[name] for name in law} == law
        assert not law.keys() & rigid["object"].attrs.keys()


@pytest.mark.parametrize("seed", range(4))
def test_articulated_objects_survive(seed: int, tmp_path: Path) -> None:
    model = random_tree(np.random.default_rng(seed), n_bodies=2 + seed)
    made = make_dataset(model, seed=seed)
    write_dataset(made, tmp_path / "a.h5")
    again = read_dataset(tmp_path / "a.h5")
    assert_same(made, again)
    assert_same_object(model, again.object)


text = st.text(st.characters(blacklist_characters="/\x00", blacklist_categories=("Cs",)), min_size=1, max_size=12)
values = st.one_of(
    st.text(st.characters(blacklist_characters="\x00", blacklist_categories=("Cs",)), max_size=30),
    st.integers(-(2**63), 2**63 - 1),
    st.floats(allow_nan=False),
    st.booleans(),
)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    names=st.lists(text.filter(lambda s: s not in (".", "..")), min_size=1, max_size=4, unique=True),
    sizes=st.lists(st.integers(2, 9), min_size=4, max_size=4),
    splits=st.lists(st.sampled_from(["", *SPLITS]), min_size=4, max_size=4),
    provenance=st.dictionaries(text, values, max_size=4),
    rate=st.floats(1e-3, 1e6),
    seed=st.integers(0, 1000),
)
def test_any_dataset_survives(
    cube: ObjectModel,
    tmp_path: Path,
    names: list[str],
    sizes: list[int],
    splits: list[str],
    provenance: dict[str, object],
    rate: float,
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    tosses = tuple(make_toss(name, n, rng, split=split) for name, n, split in zip(names, sizes, splits, strict=False))
    made = Dataset(object=cube, tosses=tosses, rate_hz=rate, source="hypothesis", provenance=provenance)
    write_dataset(made, tmp_path / "any.h5")
    assert_same(made, read_dataset(tmp_path / "any.h5"))


def test_equal_datasets_give_equal_bytes(dataset: Dataset, path: Path, tmp_path: Path) -> None:
    write_dataset(dataset, tmp_path / "again.h5")
    assert file_sha256(path) == file_sha256(tmp_path / "again.h5")
    write_dataset(replace(dataset, rate_hz=149.0), tmp_path / "other.h5")
    assert file_sha256(path) != file_sha256(tmp_path / "other.h5")


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


def test_constant_covariances_cost_little(cube: ObjectModel, tmp_path: Path) -> None:
    made = make_dataset(cube)
    toss = make_toss("long", 5000, np.random.default_rng(0))
    constant = replace(toss, q_cov=np.tile(toss.q_cov[0], (5000, 1, 1)), v_cov=np.tile(toss.v_cov[0], (5000, 1, 1)))
    write_dataset(replace(made, tosses=(constant,)), tmp_path / "a.h5")
    assert (tmp_path / "a.h5").stat().st_size < 0.5 * constant.q_cov.nbytes


# --- refused before anything is written ---


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda d: replace(d, tosses=()), "no tosses"),
        (lambda d: replace(d, rate_hz=0.0), "rate"),
        (lambda d: replace(d, rate_hz=float("nan")), "rate"),
        (lambda d: replace(d, tosses=(d.tosses[0], d.tosses[0])), "two tosses are named"),
        (lambda d: replace(d, tosses=(replace(d.tosses[0], name="a/b"),)), "cannot be named"),
        (lambda d: replace(d, tosses=(replace(d.tosses[0], name=""),)), "cannot be named"),
        (lambda d: replace(d, tosses=(make_toss("x", 5, np.random.default_rng(0), n_joints=1),)), "1 joints"),
        (lambda d: replace(d, provenance={"nested": {"a": 1}}), "nested"),
        (lambda d: replace(d, provenance={"long": "x" * 40_000}), "long"),
        (lambda d: replace(d, object="cube"), "ObjectModel"),
    ],
)
def test_what_breaks_the_schema_is_not_written(
    dataset: Dataset, tmp_path: Path, spoil: Callable[[Dataset], Dataset], says: str
) -> None:
    with pytest.raises(InputError, match=says):
        write_dataset(spoil(dataset), tmp_path / "new.h5")
    assert not list(tmp_path.iterdir())


def test_an_object_whose_text_is_out_of_date_is_written_as_it_is(cube: ObjectModel, tmp_path: Path) -> None:
    heavier = cube.with_changes(mass=2 * cube.mass, com=np.array([[0.001, 0.0, 0.0]]))
    write_dataset(make_dataset(heavier), tmp_path / "a.h5")
    again = read_dataset(tmp_path / "a.h5").object
    np.testing.assert_allclose(again.mass, [0.74], rtol=1e-6)
    np.testing.assert_allclose(again.com, [[0.001, 0, 0]], atol=1e-9)


def test_an_object_that_mjcf_cannot_say_is_refused(cube: ObjectModel, tmp_path: Path) -> None:
    # a ninth corner inside the hull is lost in a convex mesh
    inside = cube.with_changes(
        corner_pos=np.concatenate([cube.corner_pos, [[0.0, 0.0, 0.0]]]), corner_body=np.zeros(9, dtype=np.int64)
    )
    with pytest.raises(ObjectError, match="cannot be kept"):
        write_dataset(make_dataset(inside), tmp_path / "a.h5")


# --- the disk ---


def nothing_beside(path: Path) -> bool:
    return [p.name for p in path.parent.iterdir()] == [path.name]


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_a_full_disk_leaves_the_earlier_file(
    dataset: Dataset, path: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    before = path.read_bytes()

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, call, full)
    with pytest.raises(OutputError, match=r"tosses\.h5: cannot be written \(No space left on device\)"):
        write_dataset(replace(dataset, rate_hz=1.0), path)
    monkeypatch.undo()
    assert path.read_bytes() == before
    assert nothing_beside(path)


def test_a_really_full_device(dataset: Dataset, tmp_path: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    # the file beside its place leads to a device that is always full
    (tmp_path / f".a.h5.{os.getpid()}.partial").symlink_to("/dev/full")
    with pytest.raises(OutputError, match="No space left"):
        write_dataset(dataset, tmp_path / "a.h5")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("size", [3_000, 30_000, 150_000])
def test_a_disk_that_fills_up_leaves_the_earlier_file(cube: ObjectModel, path: Path, size: int) -> None:
    before, large = path.read_bytes(), make_dataset(cube, tosses=60)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        with pytest.raises(OutputError, match=r"tosses\.h5: cannot be written \(File too large\)"):
            write_dataset(large, path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == before
    assert nothing_beside(path)
    write_dataset(large, path)
    assert path.stat().st_size > 150_000
    assert_same(large, read_dataset(path))


def test_an_interrupt_leaves_the_earlier_file(dataset: Dataset, path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = path.read_bytes()

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_dataset(replace(dataset, rate_hz=1.0), path)
    assert path.read_bytes() == before
    assert nothing_beside(path)


def test_a_place_that_is_a_file_is_an_output_error(dataset: Dataset, path: Path) -> None:
    with pytest.raises(OutputError, match="cannot be written"):
        write_dataset(dataset, path / "inside.h5")


# --- damaged files ---


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
        (put("/object/mjcf", np.frombuffer(b"<mujoco", dtype="|u1")), ["MJCF"]),
        (put("/object/mjcf", np.frombuffer(b"\xff\xfe", dtype="|u1")), ["damaged"]),
        (
            put("/object/mjcf", np.frombuffer(b'<mujoco><include file="/etc/passwd"/></mujoco>', dtype="|u1")),
            ["names other files"],
        ),
        (
            put("/object/mjcf", np.frombuffer(b"<mujoco><extension><plugin/></extension></mujoco>", dtype="|u1")),
            ["plugins"],
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
