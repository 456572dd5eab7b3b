"""What is known when a diagnosis is interrupted is reported, and no more."""

from __future__ import annotations

import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen
from tossid.diagnosis.explain import begin
from tossid.diagnosis.interrupted import known_so_far
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.report.text import headline, sentences
from tossid.diagnosis.under_way import UnderWay
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.types import Toss

FEW = [EFFECTS[name] for name in ("gravity", "friction", "restitution")]


@pytest.fixture(scope="module")
def tosses(cube: ObjectModel) -> list[Toss]:
    return seen(World(cube.with_changes(friction=0.3)), cube, 6, seed=1)


def test_the_gap_the_suspects_and_what_joined_are_reported(cube: ObjectModel, tosses: list[Toss]) -> None:
    under_way = UnderWay()
    validator, first = begin(Problem(tosses, World(cube), library=FEW, under_way=under_way))
    assert under_way.so_far is not None
    early = known_so_far(under_way.so_far, "round 1")
    assert early.verdict == "incomplete"
    assert early.findings == ()
    assert early.gap.total.low > 1.5
    assert early.as_json()["complete"] is False
    assert early.as_json()["interrupted"]["during"] == "round 1"
    assert early.as_json()["interrupted"]["suspects"][0]["name"] == "friction"

    known = first.hypothesis.plus(EFFECTS["friction"])
    present = validator.cross_validate(first, EFFECTS["friction"], known)
    under_way.reached(present)
    later = known_so_far(under_way.so_far, "round 2")
    (found,) = later.findings
    assert found.verdict == "candidate"
    assert later.named == ()
    assert found.parameters["mu"].low - 0.01 < 0.3 < found.parameters["mu"].high + 0.01
    assert later.left.total.value < 0.7 * later.gap.total.value
    assert later.gap_closed.value > 0.5
    assert headline(later).startswith("Interrupted")
    assert "round 2" in sentences(later)[0]
