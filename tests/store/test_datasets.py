"""Datasets in memory and in files: read to the last bit as written, whole or not at all, and damage is refused."""

from __future__ import annotations

import json
import resource
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.physics.trees import random_tree
from tests.store.makers import assert_same, make_dataset, make_toss
from tossid.errors import FileError, InputError, ObjectError, OutputError
from tossid.objects import ObjectModel, Tag
from tossid.rotations import quat_exp
from tossid.store import (
    SCHEMA,
    Dataset,
    dataset_info,
    dataset_writer,
    file_sha256,
    open_dataset,
    read_dataset,
    write_dataset,
)
from tossid.store.hdf5 import check_heaps
from tossid.types import SPLITS, Phase, RecordingOrder, Session


def assert_same_object(a: ObjectModel, b: ObjectModel) -> None:
    for name in ("name", "friction", "restitution", "compliance", "relaxation", "cohesion", "width"):
        assert getattr(a, name) == getattr(b, name), name
    for name in ("parent", "joint_type", "joint_pos", "joint_axis", "body_pos", "body_quat", "mass", "com", "inertia"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    np.testing.assert_array_equal(a.corner_body, b.corner_body)
    np.testing.assert_array_equal(a.corner_pos, b.corner_pos)
    assert [(x.id, x.size, x.body, x.T_body_tag.tolist()) for x in a.tags] == [
        (x.id, x.size, x.body, x.T_body_tag.tolist()) for x in b.tags
    ]


def again(dataset: Dataset, folder: Path) -> Dataset:
    write_dataset(dataset, folder / "again.h5")
    return read_dataset(folder / "again.h5")


# ---------------------------------------------------------------- in memory


def test_splits_are_parts_with_their_truth(dataset: Dataset, path: Path) -> None:
    part = replace(dataset, truth=dataset).split("train")
    assert part.names == part.truth.names == tuple(toss.name for toss in dataset.tosses if toss.split == "train")
    assert (part.object, part.rate_hz, part.provenance) == (dataset.object, dataset.rate_hz, dataset.provenance)
    assert {toss.split for toss in dataset.of_split("validation", "train")} == {"validation", "train"}
    with open_dataset(path) as opened:  # still read on demand
        assert not isinstance(opened.split("test").tosses, tuple)
        np.testing.assert_array_equal(opened.split("test").tosses[0].q, dataset.split("test").tosses[0].q)
    with pytest.raises(InputError, match=r"no split 'tests'.*Did you mean 'test'"):
        dataset.split("tests")
    with pytest.raises(InputError, match="none of the 1 tosses is in split 'train'"):
        replace(dataset, tosses=dataset.split("test").tosses[:1]).split("train")


def test_it_shows_itself(dataset: Dataset) -> None:
    shown = replace(dataset, source="<made>")
    assert repr(shown) == "Dataset of 'cube': 4 tosses at 148 Hz, <made>"
    table = ElementTree.fromstring(f"<div>{shown._repr_html_()}</div>")
    cells = {row[0].text: row[1].text for row in table.iter("tr")}
    assert (cells["tosses"], cells["source"]) == ("4 (train 2, validation 1, test 1)", "<made>")
    assert len(list(table.iter("polyline"))) == 4


# ---------------------------------------------------------------- there and back


def test_a_dataset_survives_to_the_last_bit(dataset: Dataset, path: Path, tmp_path: Path) -> None:
    assert_same(dataset, read_dataset(path))
    assert_same_object(dataset.object, read_dataset(str(path)).object)
    dataset.save(tmp_path / "again.h5")
    assert file_sha256(path) == file_sha256(tmp_path / "again.h5")
    write_dataset(replace(dataset, rate_hz=149.0), tmp_path / "other.h5")
    assert file_sha256(path) != file_sha256(tmp_path / "other.h5")


OBJECTS: dict[str, Callable[[ObjectModel], ObjectModel]] = {
    "tags and a name": lambda cube: cube.with_changes(
        name="würfel", friction=0.31, restitution=0.12, width=0.2,
        tags=tuple(Tag(k, 0.04 + k / 1000, 0, np.random.default_rng(k).normal(size=(4, 4))) for k in range(6)),
    ),
    "a contact law": lambda cube: cube.with_changes(compliance=3e-5, relaxation=2e-3, cohesion=0.07),
    **{f"{n} bodies": lambda _, n=n: random_tree(np.random.default_rng(n), n_bodies=n) for n in range(2, 6)},
}  # fmt: skip


@pytest.mark.parametrize("kind", OBJECTS)
def test_objects_survive(kind: str, cube: ObjectModel, tmp_path: Path) -> None:
    model = OBJECTS[kind](cube)
    made = make_dataset(model)
    found = again(made, tmp_path)
    assert_same(made, found)
    assert_same_object(model, found.object)


def test_an_object_whose_text_is_out_of_date_is_written_as_it_is(cube: ObjectModel, tmp_path: Path) -> None:
    changes = {"mass": 2 * cube.mass, "com": np.array([[0.001, 0.0, 0.0]])}
    for model in (cube.with_changes(**changes), cube.with_changes(mjcf="", **changes)):
        found = again(make_dataset(model), tmp_path).object
        np.testing.assert_allclose(found.mass, [0.74], rtol=1e-6)
        np.testing.assert_allclose(found.com, [[0.001, 0, 0]], atol=1e-9)
        assert found.n_corners == 8


def test_measured_poses_stay_beside_smoothed_ones(dataset: Dataset, tmp_path: Path) -> None:
    smoothed = [replace(toss, q_measured=toss.q + 0.0, q_measured_cov=2 * toss.q_cov) for toss in dataset.tosses]
    first, *rest = again(replace(dataset, tosses=(dataset.tosses[0], *smoothed[1:])), tmp_path).tosses
    assert first.q_measured is None
    assert first.measured[0] is first.q
    for before, after in zip(smoothed[1:], rest, strict=True):
        np.testing.assert_array_equal(before.q_measured, after.q_measured)
        np.testing.assert_array_equal(before.q_measured_cov, after.measured[1])
    with h5py.File(tmp_path / "again.h5", "a") as file:
        del file[f"tosses/{rest[0].name}/q_measured_cov"]
    with pytest.raises(FileError, match="come together"):
        read_dataset(tmp_path / "again.h5")


def test_tosses_that_come_one_by_one_give_the_same_file(dataset: Dataset, path: Path, tmp_path: Path) -> None:
    rest = {"rate_hz": dataset.rate_hz, "source": dataset.source, "provenance": dataset.provenance}
    with dataset_writer(dataset.object, tmp_path / "a.h5") as writer:
        for toss in dataset.tosses:
            writer.add(replace(toss, split=""))
        assert not (tmp_path / "a.h5").exists()
        writer.finish(**rest, splits={toss.name: toss.split for toss in dataset.tosses})
    assert (tmp_path / "a.h5").read_bytes() == path.read_bytes()
    with (
        pytest.raises(RuntimeError, match=r"c\.h5: the block ended without"),
        dataset_writer(dataset.object, tmp_path / "c.h5") as writer,
    ):
        writer.add(dataset.tosses[0])
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.h5", "tosses.h5"]


def text(*, without: str, min_size: int = 0) -> st.SearchStrategy[str]:
    letters = st.characters(blacklist_characters=without, blacklist_categories=("Cs",))
    return st.text(letters, min_size=min_size, max_size=12)


NAMES = text(without="/\x00", min_size=1)
VALUES = text(without="\x00") | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | st.booleans()


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    names=st.lists(NAMES.filter(lambda s: s not in (".", "..")), min_size=1, max_size=4, unique=True),
    sizes=st.lists(st.integers(2, 9), min_size=4, max_size=4),
    splits=st.lists(st.sampled_from(["", *SPLITS]), min_size=4, max_size=4),
    provenance=st.dictionaries(NAMES, VALUES, max_size=4),
    rate=st.floats(1e-3, 1e6),
)
def test_any_dataset_survives(
    cube: ObjectModel,
    tmp_path: Path,
    names: list[str],
    sizes: list[int],
    splits: list[str],
    provenance: dict[str, object],
    rate: float,
) -> None:
    rng = np.random.default_rng(0)
    tosses = tuple(make_toss(name, n, rng, split=split) for name, n, split in zip(names, sizes, splits, strict=False))
    made = Dataset(object=cube, tosses=tosses, rate_hz=rate, source="hypothesis", provenance=provenance)
    assert_same(made, again(made, tmp_path))


def test_info_counts(dataset: Dataset, path: Path) -> None:
    info = dataset_info(path)
    expected = {
        "schema": SCHEMA, "object": "cube", "n_joints": 0, "n_tosses": 4, "n_frames": 12 + 13 + 14 + 15,
        "rate_hz": 148.0, "duration_s": pytest.approx((54 - 4) / 148), "source": "test", "sha256": file_sha256(path),
        "covariance_source": "made up", "splits": {"train": 2, "validation": 1, "test": 1},
        "provenance": dataset.provenance,
        "sessions": [{"first": "toss_0000", "last": "toss_0003", "n_tosses": 4, "level_deg": None}],
    }  # fmt: skip
    phases = np.concatenate([toss.phase for toss in dataset.tosses])
    assert info.pop("phases")["flight"] == (phases == Phase.FLIGHT).sum()
    assert info == expected


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
    for split, names in (("validation", ["toss_0001"]), ("", [])):
        with open_dataset(path, split=split) as opened:
            assert [toss.name for toss in opened.tosses] == names


# ---------------------------------------------------------------- the order of recording


@pytest.fixture
def ordered(cube: ObjectModel) -> Dataset:
    made, rng = make_dataset(cube, tosses=6), np.random.default_rng(0)
    values = rng.normal(size=(6, 3))
    values[2, 1] = np.nan
    order = RecordingOrder(
        sessions=(
            Session("toss_0005", "toss_0003", 3, (0.04, -0.02), (0.001, 0.002), levelled=True),
            Session("toss_0002", "toss_0000", 3, changed={"fall": 0.002}, note="no rest"),
        ),
        ordered_by="times",
        names=tuple(reversed(made.names)),
        quantities=("a", "b", "c"),
        values=values,
        places=rng.normal(size=(6, 2)),
        turn=quat_exp(0.1 * rng.normal(size=(6, 3))),
        shift=rng.normal(size=6),
        session_of=np.repeat([0, 1], 3),
        notes=("names and times differ",),
    )
    return replace(made, order=order)


def test_the_order_of_recording_survives_in_attributes(ordered: Dataset, tmp_path: Path) -> None:
    order, expected = again(ordered, tmp_path).order, ordered.order
    for name in ("sessions", "ordered_by", "names", "quantities", "notes"):
        assert getattr(order, name) == getattr(expected, name)
    for name in ("values", "places", "turn", "shift", "session_of"):
        np.testing.assert_array_equal(getattr(order, name), getattr(expected, name))
    first, second = dataset_info(tmp_path / "again.h5")["sessions"]
    assert (first["first"], first["last"], first["n_tosses"]) == ("toss_0005", "toss_0003", 3)
    assert first["level_deg"] == pytest.approx(np.rad2deg([0.04, -0.02]))
    assert (second["level_deg"], second["changed"]) == (None, {"fall": 0.002})
    with open_dataset(tmp_path / "again.h5", split="train") as part:
        assert part.order.names == tuple(reversed(part.names))
    # older readers pass over attributes
    write_dataset(replace(ordered, order=None), tmp_path / "without.h5")
    members: list[list[str]] = [[], []]
    for name, found in zip(("again.h5", "without.h5"), members, strict=True):
        with h5py.File(tmp_path / name) as file:
            file.visit(found.append)
    assert members[0] == members[1]
    assert read_dataset(tmp_path / "without.h5").order is None
    part = again(ordered.split("train"), tmp_path)
    assert len(part.order.names) == len(part)


@pytest.mark.parametrize(
    ("where", "name", "value", "says"),
    [
        ("/", "sessions", "no JSON", "does not describe the order"),
        ("/", "sessions", json.dumps({"sessions": []}), "does not describe the order"),
        ("/tosses/toss_0001", "turn", np.array([2.0, 0, 0, 0]), "no unit quaternion"),
        ("/tosses/toss_0001", "shift_m", np.nan, "not finite"),
        ("/tosses/toss_0001", "witnesses", np.zeros(2), "expected numbers of shape"),
        ("/tosses/toss_0001", "session", 7, "none of the 2"),
    ],
)
def test_a_damaged_order_is_refused(
    ordered: Dataset, tmp_path: Path, where: str, name: str, value: object, says: str
) -> None:
    write_dataset(ordered, tmp_path / "d.h5")
    with h5py.File(tmp_path / "d.h5", "r+") as file:
        file[where].attrs[name] = value
    with pytest.raises(FileError, match=says):
        read_dataset(tmp_path / "d.h5")


# ---------------------------------------------------------------- refused when written


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda d: replace(d, tosses=()), "no tosses"),
        (lambda d: replace(d, rate_hz=float("nan")), "rate"),
        (lambda d: replace(d, tosses=(d.tosses[0], d.tosses[0])), "two tosses are named"),
        (lambda d: replace(d, tosses=(replace(d.tosses[0], name="a/b"),)), "cannot be named"),
        (lambda d: replace(d, tosses=(make_toss("x", 5, np.random.default_rng(0), n_joints=1),)), "1 joints"),
        (lambda d: replace(d, provenance={"nested": {"a": 1}}), "nested"),
        (lambda d: replace(d, provenance={"long": "x" * 40_000}), "long"),
        (lambda d: replace(d, object="cube"), "ObjectModel"),
        # a ninth corner inside the hull is lost in a convex mesh
        (lambda d: replace(d, object=d.object.with_changes(
            corner_pos=np.vstack([d.object.corner_pos, np.zeros(3)]), corner_body=np.zeros(9, dtype=np.int64))),
         "cannot be kept"),
    ],
)  # fmt: skip
def test_what_breaks_the_schema_is_not_written(
    dataset: Dataset, tmp_path: Path, spoil: Callable[[Dataset], Dataset], says: str
) -> None:
    with pytest.raises((InputError, ObjectError), match=says):
        write_dataset(spoil(dataset), tmp_path / "new.h5")
    assert not list(tmp_path.iterdir())


@pytest.fixture
def kept(path: Path) -> Iterator[Path]:
    """A file that stays as it is, with nothing beside it, whatever goes wrong while it is written anew."""
    before = path.read_bytes()
    yield path
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == [path.name]


@pytest.mark.parametrize("size", [3_000, 30_000, 150_000])
def test_a_disk_that_fills_up_leaves_the_earlier_file(cube: ObjectModel, kept: Path, size: int) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        with pytest.raises(OutputError, match=r"tosses\.h5: cannot be written: the file would become too large"):
            write_dataset(make_dataset(cube, tosses=60), kept)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


# ---------------------------------------------------------------- refused when read


def refused(path: Path, *says: str) -> None:
    """Reading is one FileError in one line that names the file."""
    with pytest.raises(FileError) as caught:
        read_dataset(path)
    message = str(caught.value)
    assert "\n" not in message
    assert path.name in message
    for words in says:
        assert words in message


@pytest.mark.parametrize("share", [0.0, 0.001, 0.2, 0.6, 0.999])
def test_a_truncated_file_is_refused(path: Path, share: float) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    refused(path)
    with pytest.raises(FileError):
        dataset_info(path)


def test_flipped_bytes_are_never_read_as_data(dataset: Dataset, path: Path) -> None:
    """Every array carries a checksum: a flipped byte is an error, or it was none of the data's."""
    content, rng, caught = path.read_bytes(), np.random.default_rng(0), 0
    for place in rng.integers(0, len(content), size=60):
        damaged = bytearray(content)
        damaged[place] ^= 0xFF
        path.write_bytes(damaged)
        try:
            found = read_dataset(path)
        except FileError:
            caught += 1
            continue
        for x, y in zip(dataset.tosses, found.tosses, strict=True):
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


Change = Callable[[h5py.File], Any]
FIRST = "/tosses/toss_0000"


def put(name: str, data: object) -> Change:
    def change(file: h5py.File) -> None:
        del file[name]
        file[name] = data

    return change


def attribute(holder: str, name: str, value: object) -> Change:
    return lambda file: file[holder].attrs.__setitem__(name, value)


def drop(name: str) -> Change:
    return lambda file: file.__delitem__(name)


def times(shape: int, **how: Any) -> Change:
    """Another array of times."""

    def change(file: h5py.File) -> None:
        del file[f"{FIRST}/t"]
        file[FIRST].create_dataset("t", shape=(shape,), dtype="<f8", **how)

    return change


def virtual(file: h5py.File) -> None:
    del file[f"{FIRST}/t"]
    layout = h5py.VirtualLayout(shape=(12,), dtype="<f8")
    layout[:] = h5py.VirtualSource("/etc/hostname", "t", shape=(12,))
    file[FIRST].create_virtual_dataset("t", layout)


def mjcf(text: bytes) -> Change:
    return put("/object/mjcf", np.frombuffer(text, dtype="|u1"))


def long_quaternion(file: h5py.File) -> None:
    file["tosses/toss_0001/q"][5, 3:7] *= 1.1


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (attribute("/", "schema", "tossid.dataset/99"), ["tossid.dataset/99", "unknown", SCHEMA]),
        (attribute("/", "rate_hz", -1.0), ["rate_hz"]),
        (attribute("/", "rate_hz", "fast"), ["rate_hz", "expected float"]),
        (attribute("/", "n_tosses", 9), ["n_tosses"]),
        (attribute("/tosses/toss_0001", "index", 0), ["index"]),
        (attribute("/tosses/toss_0001", "split", "holdout"), ["/tosses/toss_0001", "holdout"]),
        (attribute("/object", "friction", -0.1), ["/object", "friction"]),
        (attribute("/object", "compliance", -1e-5), ["/object", "compliance"]),
        (attribute("/object", "nq", 8), ["joints"]),
        (attribute("/provenance", "array", np.zeros(3)), ["provenance", "array"]),
        (drop("/tosses"), ["/tosses is missing"]),
        (drop("/provenance"), ["/provenance is missing"]),
        (drop("/object/mjcf"), ["/object/mjcf is missing"]),
        (drop("/tosses/toss_0002/v_cov"), ["/tosses/toss_0002/v_cov is missing"]),
        (drop("/tosses/toss_0002"), ["index"]),
        (put(f"{FIRST}/q", np.zeros((12, 8))), [f"{FIRST}/q", "shape (12, 8)", "(12, 7)"]),
        (put(f"{FIRST}/q", np.zeros((12, 7), dtype="<f4")), [f"{FIRST}/q", "float32"]),
        (put(f"{FIRST}/q", "a string"), [f"{FIRST}/q", "type"]),
        (put(FIRST, 1.0), [f"{FIRST} is not a group"]),
        (lambda file: file.attrs.__delitem__("source"), ["'source' of / is missing"]),
        (attribute("/", "source", 3), ["'source'", "is int, expected str"]),
        (attribute("/", "n_tosses", 4.0), ["'n_tosses'", "is float, expected int"]),
        (lambda file: [file.__delitem__(f"{FIRST}/q"), file.create_group(f"{FIRST}/q")], ["q is not a data set"]),
        (put(f"{FIRST}/phase", np.full(12, 77, dtype=np.uint8)), ["phase", "77"]),
        (mjcf(b"<mujoco"), ["not valid XML"]),
        (mjcf(b"\xff\xfe"), ["damaged"]),
        (mjcf(b'<mujoco><include file="/etc/passwd"/></mujoco>'), ["names another file"]),
        (mjcf(b"<mujoco><extension><plugin/></extension></mujoco>"), ["element <extension>"]),
        (put(f"{FIRST}/t", h5py.ExternalLink("other.h5", "/t")), [f"{FIRST}/t", "link"]),
        (put(f"{FIRST}/t", h5py.SoftLink(f"{FIRST}/q")), ["link"]),
        (lambda file: file.create_dataset("surprise", data=1), ["surprise"]),
        (times(10**8, chunks=(1024,)), [f"{FIRST}/t", "declares"]),  # would fit into memory
        (times(12, external=[("/etc/hostname", 0, 96)]), ["another file"]),
        (times(12, chunks=(12,), compression="lzf"), [f"{FIRST}/t", "filter"]),
        (virtual, ["another file"]),
        (lambda file: file["tosses/toss_0001/q"].__setitem__((3, 0), np.nan), ["toss_0001", "frame 3", "finite"]),
        (long_quaternion, ["toss_0001", "frame 5", "norm 1.1"]),
        (lambda file: file["tosses/toss_0001/t"].__setitem__(4, 0.0), ["toss_0001", "frame 4", "increase"]),
    ],
)
def test_what_breaks_the_schema_is_not_read(path: Path, change: Change, says: list[str]) -> None:
    with h5py.File(path, "r+") as file:
        change(file)
    refused(path, *says)


# ---------------------------------------------------------------- endless heaps


STRINGS = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=30).flatmap(
    lambda text: st.sampled_from((text, text * 50, text * 400))
)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    rounds=st.lists(st.dictionaries(st.sampled_from("abcdefgh"), st.none() | STRINGS), min_size=1, max_size=4),
    libver=st.sampled_from((None, ("v110", "v110"), "latest")),
    user_block=st.sampled_from((0, 512)),
)
def test_heaps_that_hdf5_writes_and_edits_are_sound(
    rounds: list[dict[str, str | None]], libver: str | None, user_block: int, tmp_path: Path
) -> None:
    path = tmp_path / "any.h5"
    path.unlink(missing_ok=True)
    for number, attributes in enumerate(rounds):
        first = {} if number else {"userblock_size": user_block}
        with h5py.File(path, "a", libver=libver, **first) as file:
            for name, text in attributes.items():
                if text is None:
                    file.attrs.pop(name, None)
                else:
                    file.attrs[name] = text
            file.require_dataset(f"x{number}", shape=(5,), dtype="f8")
        check_heaps(path)


def test_a_heap_that_does_not_end_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file.attrs["one"], file.attrs["two"] = "first", "second"
    whole = path.read_bytes()
    at = whole.index(b"second") - 16
    assert whole[at : at + 2] == b"\x02\0"
    for index, length in ((0, 0), (0, 8), (2, 2**64 - 8), (2, 2**63), (0, 10**5)):
        content = bytearray(whole)
        content[at : at + 2] = index.to_bytes(2, "little")
        content[at + 8 : at + 16] = length.to_bytes(8, "little")
        path.write_bytes(content)
        with pytest.raises(FileError, match="heap of strings at byte"):
            check_heaps(path)
    path.write_bytes(whole[: whole.index(b"GCOL") + 100])
    with pytest.raises(FileError, match="does not hold together"):
        check_heaps(path)
