"""Splits are by toss, the same for the same seed, and none is empty."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.store.makers import make_toss
from tossid.errors import InputError
from tossid.store import draw_splits, drawn_splits
from tossid.types import Toss


def tosses(n: int) -> list[Toss]:
    rng = np.random.default_rng(0)
    return [make_toss(str(i), 2, rng) for i in range(n)]


MANY = tosses(200)


@given(n=st.integers(3, 200), seed=st.integers(0, 2**32))
def test_every_split_is_there_and_its_share_right(n: int, seed: int) -> None:
    count = Counter(toss.split for toss in draw_splits(MANY[:n], seed=seed))
    assert sum(count.values()) == n
    for name, share in (("train", 0.5), ("validation", 0.3), ("test", 0.2)):
        assert count[name] >= 1
        assert abs(count[name] - share * n) <= 1.5


def test_the_real_cube_is_split_as_published() -> None:
    count = Counter(toss.split for toss in draw_splits(tosses(500), seed=0))
    assert count == {"train": 250, "validation": 150, "test": 100}


def test_the_seed_decides_not_the_order() -> None:
    first = {toss.name: toss.split for toss in draw_splits(MANY, seed=3)}
    turned = {toss.name: toss.split for toss in draw_splits(MANY[::-1], seed=3)}
    other = {toss.name: toss.split for toss in draw_splits(MANY, seed=4)}
    assert first == turned
    assert first != other
    assert [toss.name for toss in draw_splits(MANY, seed=3)] == [toss.name for toss in MANY]


def test_a_split_may_be_empty_on_purpose() -> None:
    count = Counter(toss.split for toss in draw_splits(MANY, fractions=(0.0, 0.0, 1.0), seed=0))
    assert count == {"test": 200}


@pytest.mark.parametrize("fractions", [(0.5, 0.5), (0.5, 0.5, 0.5), (1.5, -0.5, 0.0), (float("nan"), 0.5, 0.5)])
def test_fractions_that_are_none_are_refused(fractions: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="fractions"):
        draw_splits(MANY, fractions=fractions, seed=0)


def test_two_tosses_of_one_name_are_refused() -> None:
    with pytest.raises(InputError, match="'0'"):
        draw_splits([MANY[0], MANY[0]], seed=0)


def test_a_copy_goes_to_the_split_of_its_first_and_all_others_stay() -> None:
    names = [toss.name for toss in MANY]
    alone = drawn_splits(names, seed=3)
    copies = {"40": "7", "41": "7", "150": "99"}
    together = drawn_splits(names, seed=3, copies=copies)
    assert any(alone[name] != alone[first] for name, first in copies.items())
    assert {name: together[name] for name in copies} == {name: alone[first] for name, first in copies.items()}
    assert {n: s for n, s in together.items() if n not in copies} == {n: s for n, s in alone.items() if n not in copies}
    # the first of the copies stands for an original that is not drawn
    fewer = [name for name in names if name != "7"]
    split = drawn_splits(fewer, seed=3, copies=copies)
    assert split["41"] == split["40"] == drawn_splits(fewer, seed=3)["40"]
