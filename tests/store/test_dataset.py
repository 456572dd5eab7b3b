"""A dataset in memory: its splits, what it shows of itself, and saving."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from tossid.errors import InputError
from tossid.store import Dataset, open_dataset, read_dataset


def test_it_gives_the_tosses_of_splits(dataset: Dataset) -> None:
    names = [toss.name for toss in dataset.of_split("validation", "train")]
    assert names == [toss.name for toss in dataset.tosses if toss.split in ("train", "validation")]


def test_a_split_is_a_dataset_with_its_truth(dataset: Dataset) -> None:
    part = replace(dataset, truth=dataset).split("train")
    assert part.truth is not None
    assert part.names == part.truth.names == tuple(toss.name for toss in dataset.tosses if toss.split == "train")
    assert len(part) == len(part.names) < len(dataset)
    assert (part.object, part.rate_hz, part.provenance) == (dataset.object, dataset.rate_hz, dataset.provenance)


def test_a_split_of_an_open_file_is_still_read_on_demand(dataset: Dataset, path: Path) -> None:
    with open_dataset(path) as opened:
        part = opened.split("test")
        assert not isinstance(part.tosses, tuple)
        np.testing.assert_array_equal(part.tosses[0].q, dataset.split("test").tosses[0].q)


def test_a_split_that_is_none_is_said(dataset: Dataset) -> None:
    with pytest.raises(InputError, match=r"no split 'tests'.*Did you mean 'test'"):
        dataset.split("tests")
    with pytest.raises(InputError, match="none of the 1 tosses is in split 'train'"):
        replace(dataset, tosses=dataset.split("test").tosses[:1]).split("train")


def test_it_shows_itself(dataset: Dataset) -> None:
    shown = replace(dataset, source="<made>")
    assert repr(shown) == "Dataset of 'cube': 4 tosses at 148 Hz, <made>"
    table = ElementTree.fromstring(f"<div>{shown._repr_html_()}</div>")
    cells = {row[0].text: row[1].text for row in table.iter("tr")}
    assert cells["tosses"] == "4 (train 2, validation 1, test 1)"
    assert cells["frames"] == f"{sum(len(toss) for toss in dataset.tosses)} at 148 Hz"
    assert cells["source"] == "<made>"
    assert len(list(table.iter("polyline"))) == 4


def test_it_saves_itself(dataset: Dataset, tmp_path: Path) -> None:
    dataset.save(tmp_path / "again.h5")
    assert read_dataset(str(tmp_path / "again.h5")).names == dataset.names
