"""What a search leaves: its alternatives, and what it says without one of its effects."""

from __future__ import annotations

from dataclasses import replace

from tests.diagnosis.by_hand import EFFECTS, hypothesis
from tests.diagnosis.selection.test_forward_selection import candidate
from tossid.diagnosis.selection.search_result import OtherCauses, SearchResult, replaced
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


def test_other_causes_stand_in_for_what_they_replace_alone(cube: ObjectModel) -> None:
    last = candidate(cube, uniform_force=[0.0, 0.0, 0.1], com_offset=[0.0, 0.0, 0.001], friction=[0.3])
    other = candidate(cube, com_offset=[0.0, 0.0, 0.001], length_scale=[0.98], world_tilt=[0.01, 0.0], cohesion=[0.1])
    needed = dict.fromkeys(("com_offset", "length_scale", "world_tilt"), other)
    wind = replace(candidate(cube, wind=[1.0, 0.0, 0.1]), effect=EFFECTS["wind"])
    found = SearchResult(candidate(cube), last, (last,), {}, {}, {}, {"uniform_force": (wind,)}, n_flight=2)
    assert found.exchanged == ((), ())
    found = replace(found, other_causes=OtherCauses(other, needed))
    assert found.exchanged == (("uniform_force",), ("length_scale", "world_tilt"))
    assert [each.name for each in found.stand_ins("uniform_force")] == ["wind", "length_scale", "world_tilt"]
    assert found.stand_ins("friction") == ()
    assert [each.names[0] for each in found.alternatives] == ["com_offset", "wind"]
    assert replace(found, n_flight=0).exchanged == ((), ())


def test_another_last_hypothesis_ends_the_history(cube: ObjectModel) -> None:
    first, last, refined = candidate(cube), candidate(cube, friction=[0.3]), candidate(cube, friction=[0.31])
    found = SearchResult(first, last, (first, last), {}, {}, {}, {}).ending_in(refined)
    assert found.present is refined
    assert found.history == (first, refined)
