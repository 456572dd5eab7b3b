"""Where the gap is, and the next toss, in sentences."""

from __future__ import annotations

from tests.diagnosis.by_hand import with_place
from tossid.diagnosis.report.localisation_text import (
    corner_paragraphs,
    next_toss_words,
    state_words,
    wrench_paragraphs,
    wrench_words,
)
from tossid.objects import ObjectModel


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
