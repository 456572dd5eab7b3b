"""What a search leaves: its alternatives, and what it says without one of its effects."""

from __future__ import annotations

from dataclasses import replace

from tests.diagnosis.by_hand import EFFECTS, hypothesis
from tests.diagnosis.selection.test_forward_selection import candidate
from tossid.diagnosis.selection.search_result import SearchResult, replaced
from tossid.objects import ObjectModel


def test_alternatives_have_one_effect_of_a_class_in_anothers_place(cube: ObjectModel) -> None:
    last = candidate(cube, gravity=[9.5], friction=[0.3])
    other = replace(candidate(cube, gravity=[9.5], cohesion=[0.2]), effect=EFFECTS["cohesion"])
    found = SearchResult(candidate(cube), last, (last,), {}, {}, {}, {"friction": (other,), "gravity": ()})
    (alternative,) = found.alternatives
    assert alternative.names == ("gravity", "cohesion")
    assert alternative.values_of("cohesion")[0] == 0.2
    assert replaced(hypothesis(cube, friction=[0.3]), "friction", other).names == ("cohesion",)
    assert list(found.without("friction").classes) == ["gravity"]
    assert replace(found, unsteady=("friction",)).unnamed == {"friction"}


def test_another_last_hypothesis_ends_the_history(cube: ObjectModel) -> None:
    first, last, refined = candidate(cube), candidate(cube, friction=[0.3]), candidate(cube, friction=[0.31])
    found = SearchResult(first, last, (first, last), {}, {}, {}, {}).ending_in(refined)
    assert found.present is refined
    assert found.history == (first, refined)
