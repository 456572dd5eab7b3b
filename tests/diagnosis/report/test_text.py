"""The sentences of a diagnosis say its verdict, its numbers and what remains."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.diagnosis.by_hand import diagnosis, hypothesis, without_effects
from tossid.diagnosis.findings import Interval, Share
from tossid.diagnosis.learned import LearnedForces, StandsFor
from tossid.diagnosis.localisation.disagreement import SolverDisagreement
from tossid.diagnosis.localisation.misspecification import Misspecification
from tossid.diagnosis.report.text import (
    headline,
    sentences,
    stated_values,
    verdict_of,
)
from tossid.objects import ObjectModel
from tossid.settings.diagnosis.report import ReportSettings


@pytest.mark.parametrize(
    ("verdict", "first", "last"),
    [
        ("no_gap", "No gap beyond the measurement noise", "the smallest size of each that these tosses would reveal"),
        ("unexplained", "The gap is not explained", "no effect of the library explains it"),
    ],
)
def test_nothing_named_is_said_as_such(cube: ObjectModel, verdict: str, first: str, last: str) -> None:
    found = without_effects(cube, verdict)
    assert headline(found) == first
    assert last in " ".join(sentences(found))


def test_what_is_left_is_said_with_its_place(cube: ObjectModel) -> None:
    left = (Share("impact", Interval(0.3, 0.2, 0.4)),)
    found = replace(diagnosis(cube), verdict="partly_explained", gap_closed=Interval(0.6, 0.5, 0.7), unexplained=left)
    assert (
        "40 % of the gap remains, a significant part of it at impacts (30 % of the original gap)"
        in sentences(found)[-1]
    )
    assert "follow an impact" not in sentences(found)[-1]
    carried = replace(found.left, after_impacts=Share("after_impacts", Interval(0.5, 0.4, 0.6)))
    said = sentences(replace(found, left=carried))[-1]
    assert "50 % lies in frames that follow an impact within the same short window" in said


def test_what_is_not_the_same_in_all_tosses_is_said_with_its_size(cube: ObjectModel) -> None:
    found = replace(diagnosis(cube), hypothesis=hypothesis(cube, uniform_force=[0.26, -0.13, 0.0]), named=())
    text = " ".join(sentences(replace(found, unsteady=("uniform_force",))))
    assert "something similar to uniform_force" in text
    assert "x 0.260 N, y −0.130 N, z 0 N), but it differs from toss to toss" in text


def test_causes_that_act_together_are_named_together(cube: ObjectModel) -> None:
    made = diagnosis(cube)
    (friction,) = (each for each in made.findings if each.name == "friction")
    friction = replace(friction, confusable_with=("anisotropic_friction", "world_tilt", "length_scale"))
    exchanged = ("friction",), ("world_tilt", "length_scale")
    found = replace(made, findings=(friction,), named=("friction",), exchanged=exchanged)
    assert headline(found).endswith("friction, anisotropic_friction or world_tilt with length_scale")


def test_an_odd_toss_is_named(cube: ObjectModel) -> None:
    found = diagnosis(cube)
    found = replace(found, gap=replace(found.gap, odd=("007",)))
    assert "Inspect toss 007: its prediction errors are far larger" in sentences(found)[-1]


def test_several_odd_tosses_are_named(cube: ObjectModel) -> None:
    found = diagnosis(cube)
    found = replace(found, gap=replace(found.gap, odd=("007", "011")))
    assert "Inspect tosses 007 and 011: their prediction errors" in sentences(found)[-1]


def test_another_law_is_said_with_its_exponent(cube: ObjectModel) -> None:
    found = replace(diagnosis(cube), other_laws=(("linear_drag", Interval(1.0, 0.8, 1.2)),))
    text = " ".join(sentences(found))
    assert "similar to linear_drag, but it follows another power law" in text
    assert "differs by +1.0 (+0.8 to +1.2) from that of linear_drag" in text


def test_values_of_the_simulator_are_those_before(cube: ObjectModel) -> None:
    assert stated_values(diagnosis(cube), "friction") == {"mu": cube.friction}
    assert stated_values(diagnosis(cube), "gravity") == {}  # not in the hypothesis


def test_verdicts_in_words(cube: ObjectModel) -> None:
    friction, _, gravity, magnus = diagnosis(cube).findings
    assert verdict_of(friction) == "confusable with cohesion"
    assert verdict_of(gravity) == "not supported"
    assert verdict_of(magnus) == "not identifiable"


def test_what_is_no_name_is_said_with_its_reason(cube: ObjectModel) -> None:
    found = replace(diagnosis(cube), implausible=(("compliance", "at_bound"), ("wind", "no_change")))
    text = " ".join(sentences(found))
    assert "like compliance, but its fit ends at the bound" in text
    assert "like wind, but the interval of its values includes no change" in text


def test_rollouts_are_those_of_the_named_effects(cube: ObjectModel) -> None:
    made = diagnosis(cube)
    error = Interval(91.0, 90.0, 92.0)
    further = replace(made.steps[-1], effects=(*made.steps[-1].effects, "inertia"), position_error_pct=error)
    before, after = (
        next(said for said in sentences(found) if "over whole tosses" in said)
        for found in (made, replace(made, steps=(*made.steps, further)))
    )
    assert after == before
    named = replace(made, steps=(*made.steps, further), candidates=("inertia",))
    assert "the position error is then 91 % of the width" in " ".join(sentences(named))


def test_a_gap_that_solvers_disagree_on_is_said_with_its_size(cube: ObjectModel) -> None:
    other = SolverDisagreement(1.42, 2.1, 2.6)
    found = replace(without_effects(cube, "within_solver_disagreement"), disagreement=other)
    assert headline(found) == "The gap is within what rigid-body solvers disagree on"
    assert "its motions differ by up to 2.1 mm and 2.6 deg" in sentences(found)[-1]


def test_what_is_named_first_depends_on_the_settings(cube: ObjectModel) -> None:
    made = diagnosis(cube)
    first = sentences(made)[0]
    assert "Most of the gap arises" in first
    high = replace(made, report=ReportSettings(main_share=1.0))
    assert "Most of the gap arises" not in sentences(high)[0]


def test_what_the_diagnosis_itself_adds_is_said(cube: ObjectModel) -> None:
    found = replace(diagnosis(cube), misspecification=Misspecification(1.31, 0.31))
    assert "leaves 1.31 standard deviations of motions that it made itself" in " ".join(sentences(found))
    quiet = replace(found, misspecification=Misspecification(1.01, 0.01))
    assert "made itself" not in " ".join(sentences(quiet))


def test_a_learned_acceleration_is_said_to_stand_for_its_forces(cube: ObjectModel) -> None:
    vortex = StandsFor("vortex", {"c_npm": 3.0}, 0.97)
    learned = LearnedForces(3.1, 0.2, small=False, effects=(vortex,), unexplained=0.03)
    found = replace(without_effects(cube, "no_gap"), learned=learned)
    said = " ".join(sentences(found))
    assert "a learned acceleration k_res: 3.10 m/s² and 0.200 rad/s² in flight" in said
    assert "It stands for vortex (c 3.00 N/m; 97 % of its mean square)." in said
    assert "The rest, 3 %, has no name." in said
    assert found.as_json()["learned_acceleration"]["stands_for"] == [
        {"name": "vortex", "parameters": {"c_npm": 3.0}, "share": 0.97}
    ]
    small = replace(found, learned=LearnedForces(0.01, 0.0, small=True))
    assert "That is next to nothing." in " ".join(sentences(small))
    unknown = replace(found, learned=LearnedForces(2.0, 0.0, small=False))
    assert "It does what no effect of the library does." in " ".join(sentences(unknown))
    assert "learned" not in " ".join(sentences(without_effects(cube, "no_gap")))
