"""What is refused is said with its reason, once for all effects or for each."""

from __future__ import annotations

from dataclasses import replace

from tossid.diagnosis.localisation.refusal import Growth, Refuted, RolloutCheck
from tossid.diagnosis.report.refusal_text import contradiction_sentences, refusal_sentences, refusal_words

from tests.diagnosis.by_hand import diagnosis
from tossid.diagnosis.findings import Interval
from tossid.diagnosis.localisation.witnesses import Witness
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


def test_what_tosses_contradict_is_said_with_both_values(cube: ObjectModel) -> None:
    sliding = Witness("friction of fast sliding", "friction", 0.18, 0.3, Interval(0.2, 0.19, 0.21), 9)
    against = replace(sliding, predicted=Interval(0.3, 0.29, 0.31), contradicts=True)
    found = replace(diagnosis(cube), verdict="unexplained", named=(), candidates=("friction",), witnesses=(against,))
    (said,) = contradiction_sentences(found)
    assert said == (
        "The friction of fast sliding is 0.200 (0.190 to 0.210) in 9 tosses, measured without a simulator. "
        "Tosses that the simulator makes with what was found have 0.300 (0.290 to 0.310). "
        "This contradicts friction: a candidate at most."
    )
    (said,) = contradiction_sentences(replace(found, witnesses=(replace(against, effect="inertia"),)))
    assert said.endswith("Nothing that was found accounts for it.")
    for silent in (replace(found, witnesses=(sliding,)), replace(found, verdict="explained")):
        assert contradiction_sentences(silent) == []


def test_what_the_search_did_without_is_said_with_its_reason(cube: ObjectModel) -> None:
    refuted = Refuted(("compliance",), WORSE)
    (said,) = contradiction_sentences(replace(diagnosis(cube), refuted=refuted))
    assert said in sentences(replace(diagnosis(cube), refuted=refuted))
    assert said.startswith("The search was repeated without compliance: in its place, what tosses show")
    assert "the position error grows by 3.9 % of the width" in said
    assert contradiction_sentences(diagnosis(cube)) == []
    told = replace(diagnosis(cube), refuted=refuted).as_json()["explanation"]["refuted"]
    assert (told["effects"], told["refused"]) == (["compliance"], True)
    assert diagnosis(cube).as_json()["explanation"]["refuted"] is None
