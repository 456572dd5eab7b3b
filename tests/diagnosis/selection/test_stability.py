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
    assert near.widened(friction, known, 5) == known
    scatter = 1.96 * np.std([0.2, 0.3, 0.4, 0.3, 0.3], ddof=1)
    wide = far.widened(friction, known, 5)["mu"]
    assert (wide.value, wide.low, wide.high) == pytest.approx((0.3, 0.3 - scatter, 0.3 + scatter))
    assert far.widened(friction, known, 6) == known
    assert far.widened(EFFECTS["restitution"], {"e": Interval(0.1, 0.0, 0.2)}, 5) == {"e": Interval(0.1, 0.0, 0.2)}
    off = Stability(tuple(Repeat(("friction",), 0.9, parameters={"friction": {"mu": x}}) for x in (0.0, 1.0, 0.0, 1.0)))
    assert off.widened(friction, known, 4)["mu"].low == friction.parameters[0].low
