"""The sentences of a diagnosis say its verdict, its numbers and what remains."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.diagnosis.by_hand import diagnosis, hypothesis, with_place, without_effects
from tossid.diagnosis.findings import Interval, Share
from tossid.diagnosis.report.text import (
    corner_paragraphs,
    headline,
    next_toss_words,
    sentences,
    state_words,
    stated_values,
    verdict_of,
    wrench_paragraphs,
    wrench_words,
)
from tossid.objects import ObjectModel


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


def test_what_is_not_the_same_in_all_tosses_is_said_with_its_size(cube: ObjectModel) -> None:
    found = replace(diagnosis(cube), hypothesis=hypothesis(cube, uniform_force=[0.26, -0.13, 0.0]), named=())
    text = " ".join(sentences(replace(found, unsteady=("uniform_force",))))
    assert "something similar to uniform_force" in text
    assert "x 0.260 N, y −0.130 N, z 0 N), but it differs from toss to toss" in text


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


def test_the_place_of_the_gap_is_said_before_and_after(cube: ObjectModel) -> None:
    made = with_place(cube)
    before, after = wrench_paragraphs(made)
    assert before.startswith("Before: In flight, the simulator lacks a force along the path that depends on the")
    assert after.startswith("With friction: In flight")
    (corner,) = corner_paragraphs(made)
    assert "4.0 times the mean" in corner
    assert "50 % (25 % to 100 %) of the gap in contact, in 40 frames" in corner


def test_joints_and_their_rates_have_names() -> None:
    assert state_words("joint_1_rate") == ("joint 1's rate", "rad/s")
    assert state_words("joint_1") == ("joint 1's angle", "rad")
    assert wrench_words("torque_joint_1") == "torque in joint 1"


def test_a_next_toss_is_said_with_all_its_numbers() -> None:
    release = {
        "attitude_wxyz": [1.0, 0.0, 0.0, 0.0],
        "velocity_ms": [0.0, 1.5, -0.5],
        "lowest_corner_m": 0.12,
        "position_m": [0.3, -0.2, 0.2],
        "horizontal_speed_ms": 1.5,
        "vertical_speed_ms": -0.5,
        "spin_rads": 8.0,
        "spin_body_rads": [8.0, 0.0, 0.0],
        "joints": [0.5],
        "joint_rates": [2.0],
    }
    found = {
        "release": release,
        "between": ["friction", "cohesion"],
        "separation_sd": 12.3,
        "separation_of_tosses_seen_sd": 3.1,
    }
    text = " ".join(next_toss_words(found))
    for piece in (
        "distinguish between friction and cohesion",
        "lowest corner 12 cm above the ground, at x = 0.30 m, y = -0.20 m",
        "1.50 m/s, 90 degrees from the x axis; 0.50 m/s down",
        "spin 8.0 rad/s, (8.0, 0.0, 0.0)",
        "joint 1 at 0.50, its rate 2.0 per second",
        "differ by 12.3 standard deviations in this toss, and by 3.1",
    ):
        assert piece in text, piece
    assert next_toss_words({"release": None, "reason": "why"}) == ["None proposed: why."]
