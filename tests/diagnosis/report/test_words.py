"""Values, changes over the order, states and releases in words."""

from __future__ import annotations

import math

import numpy as np

from tests.diagnosis.by_hand import EFFECTS, finding
from tossid.diagnosis.findings import Interval, OverOrder, Stretch
from tossid.diagnosis.report.words import (
    estimates,
    over_order_words,
    release_words,
    state_words,
    times_likelier,
    wrench_words,
)

RELEASE = {
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


def test_parameters_that_are_not_determined_are_one_item() -> None:
    wide = Interval(0.0, -np.inf, np.inf)
    made = finding(
        EFFECTS["com_offset"],
        "candidate",
        parameters={"x_m": Interval(0.003, 0.002, 0.004), "y_m": wide, "z_m": Interval(np.nan, np.nan, np.nan)},
    )
    assert estimates(made) == ["x 3.0 mm (2.0 to 4.0)", "y and z not determined"]


def test_two_recordings_in_words() -> None:
    tilts = ((np.radians(2.35), 0.0), (0.0, np.radians(0.1)))
    stretches = tuple(
        Stretch(first, last, n, {"x_rad": Interval(x, x, x), "y_rad": Interval(y, y, y)})
        for (first, last, n), (x, y) in zip((("0", "11", 12), ("12", "19", 8)), tilts, strict=True)
    )
    tilt = finding(
        EFFECTS["world_tilt"], "identified", over_order=OverOrder("steps", stretches, {}, 0.0015, undone=True)
    )
    assert over_order_words(tilt) == (
        "world_tilt changes: 2.35 deg in tosses 0 to 11; 0.10 deg in tosses 12 to 19 "
        "(p = 0.0015; the tosses were corrected for it)"
    )


def test_a_drift_has_a_rate() -> None:
    ends = (Stretch("0", "0", 1, {}), Stretch("19", "19", 1, {}))
    order = OverOrder("drift", ends, {"mu": Interval(1e-3, 9e-4, 1.1e-3)}, 0.001, undone=False)
    drifts = finding(EFFECTS["friction"], "identified", over_order=order)
    assert over_order_words(drifts) == (
        "friction drifts from toss 0 to 19: mu by 0.100 (0.090 to 0.110) per 100 tosses (p = 0.0010)"
    )


def test_joints_and_their_rates_have_names() -> None:
    assert state_words("joint_1_rate") == ("joint 1's rate", "rad/s")
    assert state_words("joint_1") == ("joint 1's angle", "rad")
    assert state_words("horizontal_speed") == ("horizontal speed", "m/s")
    assert wrench_words("torque_joint_1") == "torque in joint 1"


def test_a_release_is_one_line() -> None:
    assert release_words(RELEASE) == (
        "the lowest corner 12 cm above the ground, 1.50 m/s sideways, 0.50 m/s down, spin 8.0 rad/s"
    )


def test_a_separation_is_a_likelihood_ratio() -> None:
    assert times_likelier(math.sqrt(2 * math.log(50.0))) == "50 times"
    assert times_likelier(12.3) == "more than a million times"
