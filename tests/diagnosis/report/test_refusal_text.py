"""What is refused is said with its reason, once for all effects or for each."""

from __future__ import annotations

from dataclasses import replace

from tests.diagnosis.by_hand import diagnosis
from tossid.diagnosis.localisation.refusal import Growth, RolloutCheck
from tossid.diagnosis.report.refusal_text import refusal_sentences, refusal_words
from tossid.diagnosis.report.text import headline, sentences
from tossid.objects import ObjectModel

FINE, WORSE = Growth(-4.0, -2.0, -5.7, 1.0, 0.05), Growth(3.87, -0.2, 3.7, 2.4e-5, 0.05)


def test_what_is_refused_as_a_whole_is_in_the_headline(cube: ObjectModel) -> None:
    check = RolloutCheck(30, 30, WORSE, (("friction", WORSE),))
    refused = replace(diagnosis(cube), verdict="unexplained", named=(), candidates=("friction",), rollouts=check)
    assert headline(refused) == (
        "The gap is not explained, and what was found makes predictions of whole tosses worse; "
        "not sure: friction or cohesion"
    )
    (said,) = [line for line in sentences(refused) if line.startswith("Refused")]
    assert "30 tosses that took no part in the fits are predicted worse" in said
    assert "the position error grows by 3.9 % of the width" in said
    assert "the rotation error falls by 0.20 deg (p = 2.4e−05)" in said


def test_an_effect_that_is_refused_alone_is_named() -> None:
    check = RolloutCheck(30, 0, FINE, (("friction", FINE), ("inertia", WORSE)))
    assert refusal_words(check) == ""
    (said,) = refusal_sentences(check)
    assert said.startswith("Refused: inertia. With it, 30 tosses")


def test_nothing_is_said_where_nothing_is_refused(cube: ObjectModel) -> None:
    assert refusal_sentences(None) == refusal_sentences(RolloutCheck(30, 0, FINE, (("friction", FINE),))) == []
    assert "worse" not in headline(diagnosis(cube))
