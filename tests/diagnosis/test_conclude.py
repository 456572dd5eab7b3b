"""What is concluded from a search and its judge, or of one that is interrupted, of tosses whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen, with_effect
from tossid.diagnosis.conclude import explain, known_so_far, report_gap
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.result import Diagnosis
from tossid.diagnosis.under_way import UnderWay
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.settings.diagnosis.diagnose import DiagnoseSettings

COUNT = 12
HEAVIER = 10.3
"""Of gravity [m/s²]."""


def concluded(cube: ObjectModel, truth: World, names: tuple[str, ...], *, repeats: int = 3) -> Diagnosis:
    tosses = seen(truth, cube, COUNT, seed=5, frames=70)
    library = tuple(EFFECTS[name] for name in names)
    settings = DiagnoseSettings(repeats=repeats)
    return explain(Problem(tosses, Hypothesis(World(cube)), library=library, settings=settings))[0]


@pytest.fixture(scope="module")
def heavier(cube: ObjectModel) -> Diagnosis:
    """Of tosses in another gravity, which a clock explains as well."""
    return concluded(cube, with_effect(cube, "gravity", [HEAVIER]), ("gravity", "time_base", "friction"))


def test_what_does_the_same_is_confusable_and_named_as_a_class(heavier: Diagnosis) -> None:
    (found,) = heavier.found
    (other,) = found.confusable_with
    assert {found.name, other} == {"gravity", "time_base"}
    assert found.verdict == "confusable"
    assert found.frequency == pytest.approx(1.0, abs=0.02)
    instead = heavier.finding(other)
    assert instead is not None
    assert instead.verdict == "confusable"
    assert instead.confusable_with == (found.name,)
    gravity, clock = (heavier.finding(name) for name in ("gravity", "time_base"))
    assert gravity is not None
    assert clock is not None
    assert gravity.parameters["g_ms2"].low < HEAVIER < gravity.parameters["g_ms2"].high
    assert clock.parameters["rate_rel"].value == pytest.approx(np.sqrt(9.81 / HEAVIER), abs=2e-3)
    (alternative,) = heavier.alternatives
    assert alternative.names == (other,)


def test_the_rest_of_the_library_would_have_been_seen(heavier: Diagnosis) -> None:
    friction = heavier.finding("friction")
    assert friction is not None
    assert friction.verdict == "not_supported"
    assert 0 < friction.detectable["mu"] < 0.05
    assert friction.stated == {"mu": pytest.approx(0.18)}
    assert heavier.gap_closed.value > 0.5
    assert heavier.verdict == "explained"


def test_where_nothing_is_wrong_there_is_no_gap(cube: ObjectModel) -> None:
    nothing = concluded(cube, World(cube), ("gravity", "friction"), repeats=0)
    assert nothing.verdict == "no_gap"
    assert nothing.found == ()
    assert nothing.change == ()
    before, after = nothing.brings.position_pct()
    assert before == after


def test_what_the_library_lacks_leaves_a_gap_without_a_name(cube: ObjectModel) -> None:
    """A bounce that neither gravity nor friction explains."""
    left = concluded(cube, with_effect(cube, "restitution", [0.4]), ("gravity",), repeats=0)
    assert left.verdict == "unexplained"
    assert left.named == ()
    assert left.gap.after_impacts.value > 0.5
    assert left.unexplained.keys() & {"impact", "flight", "slide", "roll", "rest"}


def test_an_interrupted_search_tells_the_gap_then_what_joined(cube: ObjectModel) -> None:
    news: list[str] = []
    shares: list[float] = []
    tosses = seen(with_effect(cube, "friction", [0.3]), cube, 12, seed=1, frames=70)
    few = tuple(EFFECTS[name] for name in ("gravity", "friction", "restitution"))
    under_way = UnderWay(lambda what, share: shares.append(share), news.append)
    problem = Problem(tosses, Hypothesis(World(cube)), library=few, under_way=under_way)
    first = report_gap(problem)
    early = known_so_far(under_way)
    assert (early.verdict, early.findings, early.as_json()["complete"]) == ("incomplete", (), False)
    assert early.gap.total.low > 1.5
    assert "standard deviations" in news[0]
    assert "takes about" in news[1]
    assert shares == [0.0]

    problem.search().run(first)
    assert "next suspect: friction" in news
    assert any(line.startswith("found so far: friction (mu 0.") for line in news)
    later = known_so_far(under_way)
    (found,) = later.findings
    assert (found.verdict, later.named, later.candidates) == ("candidate", (), ("friction",))
    assert found.parameters["mu"].low - 0.01 < 0.3 < found.parameters["mu"].high + 0.01
    assert later.left.total.value < 0.7 * later.gap.total.value
    assert later.change[0].stated == pytest.approx(0.18)
    before, after = later.brings.position_pct()
    assert after.value < 0.5 * before.value
    assert later.brings.as_json()["took_no_part"] is False
    # a search over fewer tosses, as of a fold, is reported and not kept
    kept = under_way.present
    problem.of(tosses[:6]).search().run()
    assert under_way.present is kept
    under_way.suspects = (("gravity", 3.0),)
    assert known_so_far(under_way).as_json()["interrupted"]["suspects"] == [{"name": "gravity", "gain": 3.0}]
    for _ in range(2):
        under_way.say("the same")
    assert news.count("the same") == 1
