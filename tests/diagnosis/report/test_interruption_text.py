"""Where a diagnosis was interrupted, in words."""

from __future__ import annotations

from dataclasses import replace

from tests.diagnosis.by_hand import diagnosis
from tossid.diagnosis.report.interruption_text import interruption_sentences
from tossid.diagnosis.result import Interruption
from tossid.objects import ObjectModel


def test_the_stage_and_the_suspects_are_named(cube: ObjectModel) -> None:
    whole = diagnosis(cube)
    assert interruption_sentences(whole) == []
    searching = replace(whole, verdict="incomplete")
    (alone,) = interruption_sentences(replace(searching, interruption=Interruption("round 1", ())))
    assert "interrupted (round 1)" in alone
    assert "suspect" not in alone
    stopped = Interruption("round 2", (("friction", 9.0), ("gravity", 3.0), ("wind", 1.0)))
    (text,) = interruption_sentences(replace(searching, interruption=stopped))
    assert text.endswith("the leading suspect is friction, before gravity and wind.")


def test_an_ended_search_is_not_said_to_be_unfinished(cube: ObjectModel) -> None:
    stopped = replace(diagnosis(cube), interruption=Interruption("3 of 10 repeats of the search made"))
    (text,) = interruption_sentences(stopped)
    assert "(3 of 10 repeats of the search made). The search had ended." in text
