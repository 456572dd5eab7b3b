"""What flight cannot distinguish is decided in contact, among causes that flight alone would name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import ONCE, seen
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.flight_in_contact import FlightInContact
from tossid.diagnosis.under_way import UnderWay
from tossid.objects import ObjectModel
from tossid.physics.effects import World


def test_a_more_general_force_that_flight_cannot_tell_does_not_lead(cube: ObjectModel) -> None:
    """A pull towards a point stands for a uniform force, and what is missing in contact seems to prefer it."""
    truth = EFFECTS["uniform_force"].at(World(cube), np.array([0.05, -0.03, 0.06]))
    validator = CrossValidator.of(seen(truth, cube, 14, seed=2), cube, seed=0, settings=ONCE)
    flights = replace(validator, windows=validator.windows.rows(np.flatnonzero(validator.windows.free)))
    none = Hypothesis(World(cube))
    first = flights.evaluate(none)
    uniform, pull = EFFECTS["uniform_force"], EFFECTS["position_force"]
    group = [
        flights.cross_validate(first, uniform, none.plus(uniform)),
        flights.cross_validate(first, pull, none.plus(pull, np.array([0.05, 1.0, -0.6, 1.2]))),
    ]
    contact = FlightInContact(validator, [uniform, pull], validator.evaluate(none), UnderWay())
    assert [each.name for each in contact._may_lead(group)] == ["uniform_force"]
