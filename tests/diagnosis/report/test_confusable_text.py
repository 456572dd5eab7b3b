"""The sentences about what tosses cannot tell apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import diagnosis
from tossid.diagnosis.findings import Finding, Interval
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.report.confusable_text import confusable_sentences
from tossid.diagnosis.result import Diagnosis
from tossid.objects import ObjectModel
from tossid.physics.effects import World


def finding(name: str, *others: str, **values: float) -> Finding:
    parameters = {key: Interval(value, value - 0.01, value + 0.01) for key, value in values.items()}
    none = Interval(0.0, 0.0, 0.0)
    return Finding(name, "confusable", "it does something", ("flight",), parameters, {"gain": 1.0}, none, others)


def with_findings(cube: ObjectModel, *findings: Finding, named: str) -> Diagnosis:
    return replace(diagnosis(cube), findings=findings, named=(named,), candidates=())


def test_nothing_is_said_of_what_is_told_apart(cube: ObjectModel) -> None:
    assert confusable_sentences(with_findings(cube, finding("friction", mu=0.3), named="friction")) == []


@pytest.mark.parametrize(("gravity", "said"), [(9.61, True), (9.79, False)])
def test_gravity_that_no_place_on_earth_has_is_not_the_cause(cube: ObjectModel, gravity: float, said: bool) -> None:
    length, pull = finding("length_scale", "gravity", scale_rel=0.98), finding("gravity", "length_scale", g_ms2=gravity)
    (text,) = confusable_sentences(with_findings(cube, length, pull, named="length_scale"))
    assert "cannot distinguish length_scale from gravity: the cause may be any" in text
    assert ("so it is not the cause in real tosses" in text) == said


@pytest.mark.parametrize(("gravity", "said"), [(9.64, True), (9.5, False), (9.9, False), (9.79, False)])
def test_gravity_that_displaced_air_explains_is_said(cube: ObjectModel, gravity: float, said: bool) -> None:
    """Air of 1.2 g carries 1.2 % of an object of one litre and 100 g."""
    light = replace(cube, mass=np.array([0.1]), corner_pos=0.05 * np.sign(cube.corner_pos))
    length, pull = finding("length_scale", "gravity", scale_rel=0.98), finding("gravity", "length_scale", g_ms2=gravity)
    found = with_findings(cube, length, pull, named="length_scale")
    (text,) = confusable_sentences(replace(found, hypothesis=Hypothesis(World(light))))
    assert ("displaces carries 1.2 % of its weight, which may be why gravity seems less" in text) == said
    assert ("not the cause" in text) == (gravity in (9.5, 9.9))


def test_causes_that_do_the_same_in_flight_are_said_once_and_together(cube: ObjectModel) -> None:
    force = finding("uniform_force", "wind", "length_scale", "world_tilt", z_n=0.07)
    found = with_findings(cube, force, finding("wind", "uniform_force", x_ms=1.0), named="uniform_force")
    exchanged = ("uniform_force",), ("length_scale", "world_tilt")
    of_class, together = confusable_sentences(replace(found, exchanged=exchanged))
    assert "cannot distinguish uniform_force from wind: " in of_class
    assert together.startswith("In flight, length_scale and world_tilt together would do the same as uniform_force.")
    other = replace(found, exchanged=(("inertia",), ("com_offset",)))
    assert len(confusable_sentences(other)) == 1
