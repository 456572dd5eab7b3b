"""A diagnosis tells what it knows as soon as it does, and keeps it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.diagnosis.by_hand import EFFECTS, diagnosis
from tests.diagnosis.tossed import seen
from tossid.diagnosis.explain import begin
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.selection.stability import Repeat, Stability
from tossid.diagnosis.under_way import UnderWay
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.types import Toss

FEW = [EFFECTS[name] for name in ("gravity", "friction", "restitution")]


@pytest.fixture(scope="module")
def tosses(cube: ObjectModel) -> list[Toss]:
    return seen(World(cube.with_changes(friction=0.3)), cube, 6, seed=3)


def test_the_same_is_not_told_twice_and_a_new_beginning_starts_afresh(cube: ObjectModel, tosses: list[Toss]) -> None:
    told: list[str] = []
    under_way = UnderWay(news=told.append)
    under_way.suspected([(EFFECTS["gravity"], 1.0)])
    assert told == []  # of what, is not known yet
    validator, first = begin(Problem(tosses, World(cube), library=(), under_way=under_way))
    for gains in ((5.0, 2.0), (7.0, 3.0), (1.0, 3.0), (-1.0, -2.0)):
        under_way.suspected(list(zip(FEW, gains, strict=False)))
    assert told[1:] == ["leading suspect: gravity", "leading suspect: friction"]
    assert under_way.so_far is not None
    assert [each.gain for each in under_way.so_far.suspects] == [3.0, 1.0]
    assert "slide" in told[0]
    under_way.reached(
        replace(first, fitted=replace(first.fitted, hypothesis=first.hypothesis.plus(EFFECTS["friction"])))
    )
    assert told[-1] == "found so far: friction (mu 0.18)"
    under_way.suspected([(EFFECTS["gravity"], 1.0)])
    assert told[-1] == "leading suspect beside friction: gravity"
    under_way.begun(tosses, validator, first)
    assert under_way.so_far.present is first
    assert under_way.so_far.suspects == ()


def test_until_a_new_search_has_come_as_far_the_one_before_knows_more(cube: ObjectModel, tosses: list[Toss]) -> None:
    under_way = UnderWay()
    assert under_way.furthest is None
    validator, first = begin(Problem(tosses, World(cube), library=(), under_way=under_way))
    with_friction = replace(first, fitted=replace(first.fitted, hypothesis=first.hypothesis.plus(EFFECTS["friction"])))
    under_way.reached(with_friction)
    ended = under_way.so_far
    under_way.begun(tosses, validator, first)
    assert under_way.so_far is not ended
    assert under_way.furthest is ended
    under_way.begun(tosses, validator, first)  # a third search: the first is still the furthest
    assert under_way.furthest is ended
    under_way.reached(with_friction)
    assert under_way.furthest is under_way.so_far


def test_the_answer_is_told_before_repeats_and_kept_after_each(cube: ObjectModel) -> None:
    told: list[str] = []
    shares: list[tuple[str, float]] = []
    under_way = UnderWay(progress=lambda what, share: shares.append((what, share)), news=told.append)
    under_way.repeats = 10
    under_way("what is left", 0.9)
    made = diagnosis(cube)
    under_way.answered(made)
    assert under_way.answer is made
    assert told == ["the search names friction: explained, 93 % of the gap closed; its repeats show how sure that is"]
    for k in range(1, 11):
        repeated = replace(made, stability=Stability((Repeat(("friction",), 0.9),) * k))
        under_way.answered(repeated)
        assert under_way.answer is repeated
    under_way("next toss and patch", 0.95)
    assert shares[1][0] == "0 of 10 repeats of the search made"
    assert shares[10][0] == "9 of 10 repeats of the search made"
    assert shares[0][1] == pytest.approx(0.9 / 4)  # ten repeats take three times as long as the search
    values = [share for _, share in shares]
    assert values == sorted(values)
    assert values[-1] == 0.95
    assert len(told) == 1
