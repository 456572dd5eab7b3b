"""A diagnosis tells what it knows as soon as it does, and an interrupted one reports that and no more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.tossed import seen
from tossid.diagnosis.explain import begin
from tossid.diagnosis.interrupted import known_so_far
from tossid.diagnosis.report.text import headline, sentences
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.under_way import UnderWay
from tossid.objects import ObjectModel
from tossid.physics.effects import LIBRARY, World
from tossid.types import Toss

NAMES = {effect.name: effect for effect in LIBRARY}
FEW = [NAMES[name] for name in ("gravity", "friction", "restitution")]


@pytest.fixture(scope="module")
def tosses(cube: ObjectModel) -> list[Toss]:
    return seen(World(cube.with_changes(friction=0.3)), cube, 6, seed=3)


def test_the_gap_and_the_suspect_are_told_at_once_and_reported(cube: ObjectModel, tosses: list[Toss]) -> None:
    told: list[str] = []
    under_way = UnderWay(news=told.append)
    validator, first = begin(CrossValidator.of(tosses, cube, seed=0), World(cube), tosses, FEW, under_way)
    assert [line.partition(":")[0].partition(" is ")[0] for line in told] == ["the gap", "leading suspect"]
    assert "slide" in told[0]
    assert told[1].endswith("friction")
    assert under_way.so_far is not None
    early = known_so_far(under_way.so_far, "round 1")
    assert early.verdict == "incomplete"
    assert early.findings == ()
    assert early.gap.total.low > 1.5
    assert early.as_json()["complete"] is False
    assert early.as_json()["interrupted"]["during"] == "round 1"
    assert early.as_json()["interrupted"]["suspects"][0]["name"] == "friction"

    known = first.hypothesis.plus(NAMES["friction"])
    present = validator.cross_validate(first, NAMES["friction"], known)
    under_way.reached(present)
    assert told[2].startswith("found so far: friction (mu 0.")
    later = known_so_far(under_way.so_far, "round 2")
    (found,) = later.findings
    assert found.verdict == "candidate"
    assert later.named == ()
    assert found.parameters["mu"].low - 0.01 < 0.3 < found.parameters["mu"].high + 0.01
    assert later.left.total.value < 0.7 * later.gap.total.value
    assert later.gap_closed.value > 0.5
    assert headline(later).startswith("Interrupted")
    assert "round 2" in sentences(later)[0]


def test_the_same_is_not_told_twice_and_a_new_beginning_forgets(cube: ObjectModel, tosses: list[Toss]) -> None:
    told: list[str] = []
    under_way = UnderWay(news=told.append)
    under_way.suspected([(NAMES["gravity"], 1.0)])
    assert told == []  # of what, is not known yet
    validator, first = begin(CrossValidator.of(tosses, cube, seed=0), World(cube), tosses, (), under_way)
    for gains in ((5.0, 2.0), (7.0, 3.0), (1.0, 3.0), (-1.0, -2.0)):
        under_way.suspected(list(zip(FEW, gains, strict=False)))
    assert told[1:] == ["leading suspect: gravity", "leading suspect: friction"]
    assert under_way.so_far is not None
    assert [each.gain for each in under_way.so_far.suspects] == [3.0, 1.0]
    moved = replace(first, gain=np.ones(1))
    under_way.reached(moved)
    under_way.begun(tosses, validator, first)
    assert under_way.so_far.present is first
    assert under_way.so_far.suspects == ()
