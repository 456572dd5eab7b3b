"""The measurement of copies: the earlier draw, and which tosses are left out to see what copies were worth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipelines.tools.experiments import copies
from tests.models.made import tosses
from tossid.motion.sessions.copies import leak_words
from tossid.motion.sessions.levelling import turned_track
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp
from tossid.store import Dataset, drawn_splits
from tossid.types import PoseTrack, Toss


def turned(toss: Toss, name: str, split: str) -> Toss:
    track = turned_track(PoseTrack(toss.name, toss.t, toss.q), quat_exp(np.array([0.0, 0.0, 1.0])), 0.0)
    return replace(toss, name=name, q=track.q, split=split)


@pytest.fixture(scope="module")
def dataset(cube: ObjectModel) -> Dataset:
    made = tuple(replace(toss, split="train") for toss in tosses(cube, 12, seed=3))
    more = (turned(made[0], "a", "test"), turned(made[1], "b", "validation"), turned(made[2], "c", "test"))
    rest = [replace(toss, split="test") if toss.name in {made[5].name, made[6].name} else toss for toss in made[3:]]
    validation = replace(made[2], split="validation")
    return Dataset(cube, (*made[:2], validation, *rest, *more), 148.0, "made")


def test_only_tosses_that_equal_a_test_toss_are_left_out(dataset: Dataset) -> None:
    left = copies.without_twins(dataset)
    gone = set(dataset.names) - set(left.names)
    assert gone == {dataset.names[0], dataset.names[2]}
    assert [len(left.of_split(split)) for split in ("train", "validation", "test")] == [8, 1, 4]
    assert leak_words(left.tosses) is not None  # the copy in validation of a training toss is no test toss
    by_name = copies.drawn_by_name(dataset)
    assert {toss.name: toss.split for toss in by_name.tosses} == drawn_splits(dataset.names, seed=0)


def test_rows_compare_the_same_tosses(dataset: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    # (a model is how many tosses it was given)
    monkeypatch.setattr("tossid.train", lambda data, **_: len(data))
    monkeypatch.setattr(copies, "scores_of", lambda model, held: np.full((len(held), 2), [1.0, 2.0]) * model)
    rows = copies.rows_of("cn", dataset)
    assert [row[2] for row in rows] == ["4", "2", "2", "2", "2", "4"]
    assert rows[2][4] == "15.00 (15.00 to 15.00)"
    assert rows[4][4:] == ["-2.00 (-2.00 to -2.00)", "-4.00 (-4.00 to -4.00)"]
    assert rows[0][1] == "all"
    assert rows[3][1] == "2 less"
