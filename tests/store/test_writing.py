"""What is written is read back to the last bit, and a file appears whole or not at all."""

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
from tests.store.makers import assert_same, make_dataset, make_toss
from tossid import outputs
from tossid.errors import FileError, InputError, ObjectError, OutputError
from tossid.objects import ObjectModel, Tag
from tossid.store import (
    Dataset,
    dataset_writer,
    file_sha256,
    read_dataset,
    write_dataset,
)
from tossid.types import SPLITS


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
    with pytest.raises(OutputError, match=r"tosses\.h5: cannot be written: the disk is full"):
        write_dataset(replace(dataset, rate_hz=1.0), path)
    monkeypatch.undo()
    assert path.read_bytes() == before
    assert nothing_beside(path)


def test_a_really_full_device(dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    # the file beside its place leads to a device that is always full
    beside = tmp_path / ".a.tmp-1-00000000.h5"
    beside.symlink_to("/dev/full")
    monkeypatch.setattr(outputs, "_remove_stale", lambda path: None)
    monkeypatch.setattr(outputs, "_temporary", lambda path: beside)
    with pytest.raises(OutputError, match="the disk is full"):
        write_dataset(dataset, tmp_path / "a.h5")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("size", [3_000, 30_000, 150_000])
def test_a_disk_that_fills_up_leaves_the_earlier_file(cube: ObjectModel, path: Path, size: int) -> None:
    before, large = path.read_bytes(), make_dataset(cube, tosses=60)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        with pytest.raises(OutputError, match=r"tosses\.h5: cannot be written: the file would become too large"):
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
