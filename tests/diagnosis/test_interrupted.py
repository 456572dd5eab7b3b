"""What is known when a diagnosis is interrupted is reported, and no more."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen, with_effect
from tossid.diagnosis.conclude import report_gap
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.interrupted import known_so_far
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.under_way import UnderWay
from tossid.objects import ObjectModel
from tossid.physics.effects import World


@pytest.fixture(scope="module")
def problem(cube: ObjectModel) -> Problem:
    """Twelve tosses with friction 0.3, where 0.18 is stated."""
    tosses = seen(with_effect(cube, "friction", [0.3]), cube, 12, seed=1, frames=70)
    few = tuple(EFFECTS[name] for name in ("gravity", "friction", "restitution"))
    return Problem(tosses, Hypothesis(World(cube)), library=few, under_way=UnderWay())


def test_the_gap_alone_is_known_at_first_then_suspects_and_what_joined(problem: Problem) -> None:
    under_way = problem.under_way
    first = report_gap(problem)
    assert under_way.so_far is not None
    early = known_so_far(under_way.so_far, "the gap")
    assert early.verdict == "incomplete"
    assert early.findings == ()
    assert early.gap.total.low > 1.5
    assert early.as_json()["complete"] is False

    problem.search().run(first)
    later = known_so_far(under_way.so_far, "the search")
    (found,) = later.findings
    assert found.verdict == "candidate"
    assert later.named == ()
    assert later.candidates == ("friction",)
    assert found.parameters["mu"].low - 0.01 < 0.3 < found.parameters["mu"].high + 0.01
    assert later.left.total.value < 0.7 * later.gap.total.value
    assert later.change[0].stated == pytest.approx(0.18)
    before, after = later.brings.position_pct()
    assert after.value < 0.5 * before.value
    assert later.brings.as_json()["took_no_part"] is False
    named = replace(under_way.so_far, suspects=(("gravity", 3.0),))
    assert known_so_far(named, "x").as_json()["interrupted"]["suspects"] == [{"name": "gravity", "gain": 3.0}]
