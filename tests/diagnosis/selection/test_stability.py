"""What is concluded from repeats of the search: frequencies, and intervals that hold the scatter of values."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tossid.diagnosis.findings import Interval
from tossid.diagnosis.selection.stability import Repeat, Stability


def test_frequencies_count_repeats() -> None:
    names = (("friction",), 0.9), (("cohesion",), 0.8), ((), 0.0), (("friction", "wind"), 0.3)
    found = Stability(tuple(Repeat(*each) for each in names), 0.5)
    assert found.frequency(["friction"]) == 0.5
    assert found.frequency(["friction", "cohesion"]) == 0.75
    assert found.frequency(["gravity"]) == 0.0
    general = Stability((Repeat(("velocity_friction",), 0.9, frozenset({"friction"})),))
    assert general.frequency(["friction"]) == 1.0
    # one names nothing, and another closes too little
    assert found.probability_none == 0.5
    assert Stability().frequency(["friction"]) is None
    assert Stability().probability_none is None


def test_intervals_are_no_narrower_than_the_scatter_of_repeats() -> None:
    friction, known = EFFECTS["friction"], {"mu": Interval(0.30, 0.29, 0.31)}
    near, far = (
        Stability(tuple(Repeat(("friction",), 0.9, parameters={"friction": {"mu": x}}) for x in values))
        for values in ((0.299, 0.3, 0.301, 0.3, 0.3), (0.2, 0.3, 0.4, 0.3, 0.3))
    )
    assert near.widened(friction, known, ["friction"], 5) == known
    scatter = 1.96 * np.std([0.2, 0.3, 0.4, 0.3, 0.3], ddof=1)
    wide = far.widened(friction, known, ["friction"], 5)["mu"]
    assert (wide.value, wide.low, wide.high) == pytest.approx((0.3, 0.3 - scatter, 0.3 + scatter))
    assert far.widened(friction, known, ["friction"], 6) == known
    bounce = {"e": Interval(0.1, 0.0, 0.2)}
    assert far.widened(EFFECTS["restitution"], bounce, ["restitution"], 5) == bounce
    off = Stability(tuple(Repeat(("friction",), 0.9, parameters={"friction": {"mu": x}}) for x in (0.0, 1.0, 0.0, 1.0)))
    assert off.widened(friction, known, ["friction"], 4)["mu"].low == friction.parameters[0].low


def test_values_beside_others_of_a_group_are_not_compared() -> None:
    tilt = EFFECTS["ground_tilt"]

    def repeat(x: float, *others: str, nameless: tuple[str, ...] = ()) -> Repeat:
        named = {"ground_tilt": {"x_rad": x, "y_rad": 0.0}}
        return Repeat(("ground_tilt", *others), 0.9, parameters=named, nameless=nameless)

    alone = (repeat(0.007, "friction"), repeat(0.0072))
    found = Stability((*alone, repeat(-0.006, "world_tilt"), repeat(-0.006, nameless=("world_tilt",))))
    scatter = found.scatter(tilt, ["ground_tilt", "restitution"], 2)
    assert scatter == pytest.approx({"x_rad": 1.96 * 0.0002 / 2**0.5, "y_rad": 0.0})
    assert found.scatter(tilt, ["ground_tilt"], 3) == {}
    assert found.scatter(tilt, ["ground_tilt", "world_tilt"], 2)["x_rad"] == 0.0
    assert found.repeats[3].as_json()["nameless"] == ["world_tilt"]
