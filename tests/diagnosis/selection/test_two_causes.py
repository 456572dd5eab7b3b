"""Two causes that act in flight as one force does, and what contact says of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import ONCE, seen
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.flight_search import search_flight
from tossid.diagnosis.selection.forward_selection import ForwardSelection
from tossid.diagnosis.selection.two_causes import in_contact
from tossid.diagnosis.under_way import UnderWay
from tossid.objects import ObjectModel
from tossid.physics.effects import RecordingErrors, World

SCALE, TILT = 0.97, (0.02, -0.03)
PULL = 0.37 * 9.81 * np.array([SCALE * TILT[1] * -1, SCALE * TILT[0], 1 - SCALE])
"""The force under which an object of 0.37 kg falls as it is recorded in a world of that scale and tilt [N]."""


@pytest.fixture(scope="module")
def recorded_short(cube: ObjectModel) -> CrossValidator:
    """Tosses of a cube that bounces, in a recording whose lengths are too short, and whose world is tilted."""
    bounces = EFFECTS["restitution"].at(World(cube), np.array([0.3]))
    truth = replace(bounces, recording=RecordingErrors(length_scale=SCALE, world_tilt=TILT))
    return CrossValidator.of(seen(truth, cube, 12, seed=3), cube, seed=0, settings=ONCE)


def with_effects(world: World, **values: list[float]) -> Hypothesis:
    hypothesis = Hypothesis(world)
    for name, each in values.items():
        hypothesis = hypothesis.plus(EFFECTS[name], np.array(each))
    return hypothesis


def test_flight_shows_both_and_what_could_stand_in_for_each(cube: ObjectModel, recorded_short: CrossValidator) -> None:
    library = [EFFECTS[name] for name in ("uniform_force", "gravity", "length_scale", "world_tilt", "linear_drag")]
    found = search_flight(recorded_short, library, Hypothesis(World(cube)))
    assert found is not None
    assert found.instead is not None
    assert found.present.hypothesis.names == ("uniform_force",)
    names = set(found.instead.present.hypothesis.names)
    assert names in ({"world_tilt", "length_scale"}, {"world_tilt", "gravity"})
    (shorter,) = names - {"world_tilt"}
    assert {each.name for each in found.instead.classes[shorter]} == {"gravity", "length_scale"} - {shorter}
    assert found.instead.present.hypothesis.values_of("world_tilt") == pytest.approx(TILT, abs=0.002)


def test_contact_that_made_up_for_two_causes_leaves_with_the_one(
    cube: ObjectModel, recorded_short: CrossValidator
) -> None:
    world = World(cube)
    one = with_effects(world, uniform_force=[*PULL], restitution=[0.3], geometry=[SCALE], ground_tilt=[*TILT])
    found = recorded_short.evaluate(one)
    two = with_effects(world, world_tilt=[*TILT], length_scale=[SCALE])
    rounds = ForwardSelection(replace(recorded_short, held=frozenset(two.names)), [], UnderWay())
    made = in_contact(rounds, recorded_short.evaluate(Hypothesis(world)), found, two, 1)
    assert made is not None
    assert made.two
    assert set(made.chosen.hypothesis.names) == {"world_tilt", "length_scale", "restitution"}
    assert made.chosen.hypothesis.values_of("length_scale")[0] == pytest.approx(SCALE, abs=0.001)
    assert made.other.hypothesis.names == one.names


def test_a_force_and_another_size_stay(cube: ObjectModel) -> None:
    """The ground is level, which no tilt of the whole world leaves it."""
    truth = with_effects(World(cube), uniform_force=[*PULL], geometry=[SCALE])
    validator = CrossValidator.of(seen(truth.world(), cube, 12, seed=3), cube, seed=0, settings=ONCE)
    two = with_effects(World(cube), world_tilt=[*TILT], length_scale=[SCALE])
    rounds = ForwardSelection(replace(validator, held=frozenset(two.names)), [], UnderWay())
    first = validator.evaluate(Hypothesis(World(cube)))
    made = in_contact(rounds, first, validator.evaluate(truth), two, 1)
    assert made is not None
    assert (made.two, made.decided) == (False, True)
    assert made.chosen.hypothesis.names == truth.names


def test_contact_that_is_not_modelled_does_not_decide(cube: ObjectModel) -> None:
    """The cube sticks and bounces, which neither hypothesis has: most of the gap stays with both."""
    world = World(cube)
    one = with_effects(world, uniform_force=[*PULL], geometry=[SCALE], ground_tilt=[*TILT])
    sticky = one.plus(EFFECTS["adhesion"], np.array([2.0])).plus(EFFECTS["restitution"], np.array([0.5]))
    validator = CrossValidator.of(seen(sticky.world(), cube, 12, seed=3), cube, seed=0, settings=ONCE)
    two = with_effects(world, world_tilt=[*TILT], length_scale=[SCALE])
    rounds = ForwardSelection(replace(validator, held=frozenset(two.names)), [], UnderWay())
    made = in_contact(rounds, validator.evaluate(Hypothesis(world)), validator.evaluate(one), two, 1)
    assert made is not None
    assert not made.decided
