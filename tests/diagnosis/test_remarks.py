"""What is said beside a diagnosis."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from tests.diagnosis.by_hand import diagnosis, without_effects
from tossid.diagnosis.inference.hypothesis import RELAXED, ROUTH, ContactLaw
from tossid.diagnosis.remarks import remarks_on
from tossid.diagnosis.simulators import Simulator, nominal
from tossid.objects import ObjectModel


def test_few_tosses_without_a_name_are_said(cube: ObjectModel) -> None:
    few = without_effects(cube, "unexplained", n=6)
    said = remarks_on(replace(few, changes_left=()), nominal(cube))
    assert len(said) == 1
    assert said[0].startswith("6 tosses are too few")
    assert remarks_on(replace(diagnosis(cube, n=6), changes_left=()), nominal(cube)) == ()
    assert remarks_on(replace(without_effects(cube, "no_gap", n=6), changes_left=()), nominal(cube)) == ()


def test_an_order_that_was_not_looked_at_is_said(cube: ObjectModel) -> None:
    (said,) = remarks_on(diagnosis(cube), nominal(cube))
    assert "too few for a change" in said


def test_another_law_of_contact_is_said(cube: ObjectModel) -> None:
    made = replace(diagnosis(cube), changes_left=())

    def under(law: object, simulator: Simulator) -> str:
        return " ".join(remarks_on(replace(made, hypothesis=replace(made.hypothesis, law=law)), simulator))

    stated = nominal(cube)
    assert "Routh's law" in under(ROUTH, stated)
    assert "relaxed friction" in under(RELAXED, stated)
    assert under(made.hypothesis.law, stated) == ""
    own = replace(stated, mjcf=Path("cube.xml"), contact=(ContactLaw("own"),))
    assert "the patch makes the model's contact rigid" in under(made.hypothesis.law, own)
