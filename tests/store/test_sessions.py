"""The order of recording survives a file, older files have none, and damaged ones are refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from tests.store.makers import make_dataset
from tossid.errors import FileError
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp
from tossid.store import Dataset, dataset_info, open_dataset, read_dataset, write_dataset
from tossid.types import RecordingOrder, Session


@pytest.fixture
def dataset(cube: ObjectModel) -> Dataset:
    made = make_dataset(cube, tosses=6)
    rng = np.random.default_rng(0)
    values = rng.normal(size=(6, 3))
    values[2, 1] = np.nan
    order = RecordingOrder(
        (
            Session("toss_0005", "toss_0003", 3, (0.04, -0.02), (0.001, 0.002), levelled=True),
            Session("toss_0002", "toss_0000", 3, changed={"fall": 0.002}, note="no rest"),
        ),
        "times",
        tuple(reversed(made.names)),
        ("a", "b", "c"),
        values,
        rng.normal(size=(6, 2)),
        quat_exp(0.1 * rng.normal(size=(6, 3))),
        rng.normal(size=6),
        np.repeat([0, 1], 3),
        ("names and times differ",),
    )
    return replace(made, order=order)


def test_what_is_written_is_read(dataset: Dataset, tmp_path: Path) -> None:
    write_dataset(dataset, tmp_path / "d.h5")
    order, expected = read_dataset(tmp_path / "d.h5").order, dataset.order
    assert order is not None
    assert expected is not None
    assert (order.sessions, order.ordered_by, order.names) == (expected.sessions, expected.ordered_by, expected.names)
    assert (order.quantities, order.notes) == (expected.quantities, expected.notes)
    for name in ("values", "places", "turn", "shift", "session_of"):
        np.testing.assert_array_equal(getattr(order, name), getattr(expected, name))


def test_info_lists_the_sessions(dataset: Dataset, tmp_path: Path) -> None:
    write_dataset(dataset, tmp_path / "d.h5")
    first, second = dataset_info(tmp_path / "d.h5")["sessions"]
    assert (first["first"], first["last"], first["n_tosses"]) == ("toss_0005", "toss_0003", 3)
    assert first["level_deg"] == pytest.approx(np.rad2deg([0.04, -0.02]))
    assert second["level_deg"] is None
    assert second["changed"] == {"fall": 0.002}


def test_a_file_without_it_is_one_session(dataset: Dataset, tmp_path: Path) -> None:
    write_dataset(replace(dataset, order=None), tmp_path / "d.h5")
    assert read_dataset(tmp_path / "d.h5").order is None
    (session,) = dataset_info(tmp_path / "d.h5")["sessions"]
    assert session == {"first": "toss_0000", "last": "toss_0005", "n_tosses": 6, "level_deg": None}


def test_it_lies_in_attributes_only_which_older_readers_pass_over(dataset: Dataset, tmp_path: Path) -> None:
    for name, made in (("with.h5", dataset), ("without.h5", replace(dataset, order=None))):
        write_dataset(made, tmp_path / name)
    members: list[list[str]] = []
    for name in ("with.h5", "without.h5"):
        with h5py.File(tmp_path / name) as file:
            members.append([])
            file.visit(members[-1].append)
            assert file.attrs["schema"] == "tossid.dataset/1"
    assert members[0] == members[1]


def test_a_part_of_the_tosses_keeps_its_part(dataset: Dataset, tmp_path: Path) -> None:
    write_dataset(dataset, tmp_path / "d.h5")
    with open_dataset(tmp_path / "d.h5", split="train") as part:
        assert part.order is not None
        assert part.order.names == tuple(reversed(part.names))
    write_dataset(dataset.split("train"), tmp_path / "part.h5")
    order = read_dataset(tmp_path / "part.h5").order
    assert order is not None
    assert len(order.names) == len(dataset.split("train"))


@pytest.mark.parametrize(
    ("where", "name", "value", "said"),
    [
        ("/", "sessions", "no JSON", "does not describe the order"),
        ("/", "sessions", json.dumps({"sessions": []}), "does not describe the order"),
        ("/tosses/toss_0001", "turn", np.array([2.0, 0, 0, 0]), "no unit quaternion"),
        ("/tosses/toss_0001", "shift_m", np.nan, "not finite"),
        ("/tosses/toss_0001", "witnesses", np.zeros(2), "expected numbers of shape"),
        ("/tosses/toss_0001", "session", 7, "none of the 2"),
    ],
)
def test_damage_is_one_clear_error(
    dataset: Dataset, tmp_path: Path, where: str, name: str, value: object, said: str
) -> None:
    write_dataset(dataset, tmp_path / "d.h5")
    with h5py.File(tmp_path / "d.h5", "r+") as file:
        file[where].attrs[name] = value
    with pytest.raises(FileError, match=said):
        read_dataset(tmp_path / "d.h5")
