"""A verdict that tosses do not decide is said to be one."""

from __future__ import annotations

from dataclasses import replace

from tests.diagnosis.by_hand import diagnosis
from tossid.diagnosis.findings import Interval
from tossid.diagnosis.localisation.refusal import Growth, RolloutCheck
from tossid.diagnosis.report.limit_text import limit_sentences
from tossid.diagnosis.report.text import sentences
from tossid.objects import ObjectModel


def test_a_limit_within_the_interval_is_said(cube: ObjectModel) -> None:
    made = replace(diagnosis(cube), verdict="partly_explained", gap_closed=Interval(0.51, 0.47, 0.55))
    (said,) = limit_sentences(made)
    assert said in sentences(made)
    assert said.startswith("A gap is partly explained from 50 % on.")
    assert limit_sentences(replace(made, verdict="unexplained")) == [said]
    sure = replace(made, gap_closed=Interval(0.6, 0.55, 0.65))
    for other in (sure, replace(made, verdict="explained"), replace(made, verdict="no_gap")):
        assert limit_sentences(other) == []


def test_nothing_hangs_on_the_limit_where_whole_tosses_refuse_all(cube: ObjectModel) -> None:
    made = replace(diagnosis(cube), verdict="unexplained", gap_closed=Interval(0.51, 0.47, 0.55))
    for p_value, said in ((0.001, 0), (0.5, 1)):
        whole = Growth(3.0, 2.0, 4.0, p_value, 0.05)
        assert len(limit_sentences(replace(made, rollouts=RolloutCheck(20, 20, whole)))) == said
