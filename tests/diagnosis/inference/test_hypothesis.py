"""Hypotheses are values: effects join, leave and change places, and the world follows."""

from __future__ import annotations

import numpy as np

from tests.diagnosis.by_hand import EFFECTS
from tossid.diagnosis.inference.hypothesis import ContactLaw, Hypothesis


def test_effects_join_leave_and_change_places(stated: Hypothesis) -> None:
    two = stated.plus(EFFECTS["gravity"], np.array([9.7])).plus(EFFECTS["friction"], np.array([0.3]))
    assert two.names == ("gravity", "friction")
    assert two.world().gravity == 9.7
    assert two.world().object.friction == 0.3
    assert two.without("gravity").world().gravity == stated.base.gravity
    other = two.with_replaced("gravity", EFFECTS["time_base"], np.array([1.01]))
    assert other.names == ("time_base", "friction")
    assert other.world().recording.clock_rate == 1.01


def test_parameters_are_flat_scaled_and_bounded(stated: Hypothesis) -> None:
    h = stated.plus(EFFECTS["com_offset"]).plus(EFFECTS["friction"])
    assert h.owners == ["com_offset"] * 3 + ["friction"]
    assert h.flat().tolist() == [0.0, 0.0, 0.0, stated.base.object.friction]
    assert h.nominal_of("friction").tolist() == [stated.base.object.friction]
    moved = h.at(np.array([1.0, -1.0, 0.001, 0.5]))
    low, high = h.bounds
    assert moved.flat().tolist() == [high[0], low[1], 0.001, 0.5]
    assert h.place_of("friction") == slice(3, 4)


def test_a_law_of_contact_is_that_of_the_world(stated: Hypothesis) -> None:
    relaxed = Hypothesis(stated.base, ContactLaw("relaxed", lifting=1e-4))
    assert relaxed.world().law.lifting == 1e-4
    assert stated.world() is stated.world()
    assert stated.world().law.lifting == 0.0
