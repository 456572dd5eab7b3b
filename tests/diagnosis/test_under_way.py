"""A diagnosis reports what it knows as soon as it does, and keeps it."""

from __future__ import annotations

import numpy as np

from tests.diagnosis.tossed import seen, with_effect
from tossid.diagnosis.conclude import report_gap
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.under_way import UnderWay
from tossid.objects import ObjectModel
from tossid.physics.effects import World


def test_news_come_once_and_a_search_over_fewer_tosses_is_not_kept(cube: ObjectModel) -> None:
    news: list[str] = []
    shares: list[float] = []
    under_way = UnderWay(progress=lambda what, share: shares.append(share), news=news.append)
    tosses = seen(with_effect(cube, "friction", [0.3]), cube, 6, seed=3, frames=60)
    friction = tuple(e for e in Problem(tosses, Hypothesis(World(cube))).library if e.name == "friction")
    problem = Problem(tosses, Hypothesis(World(cube)), library=friction, under_way=under_way)
    first = report_gap(problem)
    assert "standard deviations" in news[0]
    assert " mm, " in news[0]
    assert "takes about" in news[1]
    for _ in range(2):
        under_way.say("the same")
    assert news.count("the same") == 1
    search = problem.search()
    round_ = search._round(search.sample.fixed(first), first, friction, frozenset())
    assert news[-1] == "next suspect: friction"
    assert under_way.so_far is not None
    assert under_way.so_far.suspects[0][0] == "friction"
    kept = under_way.so_far
    fewer = search.sample.of_tosses(np.arange(3))
    under_way.watched(fewer.fixed(fewer.evidence(problem.stated)), round_.screening)
    assert under_way.so_far is kept
    assert shares == [0.0]
