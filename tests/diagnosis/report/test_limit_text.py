"""A verdict that tosses do not decide is said to be one."""

from __future__ import annotations

from dataclasses import replace

from tests.diagnosis.by_hand import diagnosis
from tossid.diagnosis.findings import Interval
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
