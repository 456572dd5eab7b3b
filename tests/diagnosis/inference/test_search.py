"""The search names what tosses were made with, at its size, and nothing where nothing is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.inference.conftest import FRICTION
from tests.diagnosis.tossed import with_effect
from tossid.diagnosis.inference.found import Found, words
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.inference.search import Search
from tossid.objects import ObjectModel
from tossid.physics.effects import World, effects_for


@pytest.fixture(scope="module")
def searched(cube: ObjectModel, stated: Hypothesis) -> Callable[[Sample], Found]:
    return lambda sample: Search(sample, effects_for(cube), stated).run()


def test_friction_is_named_at_its_size(slippery: Sample, searched: Callable[[Sample], Found]) -> None:
    found = searched(slippery)
    assert found.hypothesis.names == ("friction",)
    assert found.hypothesis.flat()[0] == pytest.approx(FRICTION, abs=0.005)
    assert found.needed["friction"].sum() > 100
    assert words(found.hypothesis).startswith("coulomb; friction 0.2")


def test_nothing_is_named_where_nothing_is(
    cube: ObjectModel, sample_of: Callable[..., Sample], searched: Callable[[Sample], Found]
) -> None:
    found = searched(sample_of(World(cube), seed=11))
    assert found.hypothesis.names == ()
    assert found.needed == {}


def test_flight_finds_the_centre_of_mass_and_contact_tells_it_from_the_frame(
    cube: ObjectModel, sample_of: Callable[..., Sample], searched: Callable[[Sample], Found]
) -> None:
    found = searched(sample_of(with_effect(cube, "com_offset", [0.0, 0.0, 0.006]), seed=5))
    assert found.hypothesis.names == ("com_offset",)
    assert found.flown == {"com_offset"}
    assert found.hypothesis.flat() == pytest.approx([0.0, 0.0, 0.006], abs=1e-3)
    rivals = {rival.effect.name: rival for rival in found.rivals["com_offset"]}
    assert not rivals["body_frame_offset"].is_alike


@pytest.mark.parametrize("seed", [4, 7])
def test_of_two_that_no_likelihood_tells_apart_the_library_first_one_stands(
    cube: ObjectModel, sample_of: Callable[..., Sample], searched: Callable[[Sample], Found], seed: int
) -> None:
    """Rigid contact has no unit of time: a clock does what gravity does, whichever noise makes likelier."""
    found = searched(sample_of(World(cube, gravity=10.2), seed=seed))
    assert found.hypothesis.names == ("gravity",)
    assert found.hypothesis.flat()[0] == pytest.approx(10.2, abs=0.02)
    assert "time_base" in {rival.effect.name for rival in found.alike("gravity")}


def test_effects_of_flight_and_of_contact_are_both_named(
    cube: ObjectModel, sample_of: Callable[..., Sample], searched: Callable[[Sample], Found]
) -> None:
    world = replace(with_effect(cube, "restitution", [0.3]), gravity=10.2)
    found = searched(sample_of(world, seed=6))
    values = {effect.name: value[0] for effect, value in found.hypothesis.items()}
    assert values["restitution"] == pytest.approx(0.3, abs=0.02)
    alike = {
        name
        for name, group in found.rivals.items()
        for rival in group
        if rival.is_alike
        for name in (name, rival.effect.name)
    }
    assert "gravity" in {*values, *alike}
    assert len(values) == 2


def test_a_force_of_another_law_is_found_with_its_power(cube: ObjectModel, sample_of: Callable[..., Sample]) -> None:
    """Drag that grows with the cube of the speed is no quadratic drag, and has no name."""
    effects = {name: EFFECTS[name] for name in ("quadratic_drag", "position_force", "wind")}
    quadratic = effects["quadratic_drag"].at(World(cube), np.array([0.2]))
    law = effects["quadratic_drag"].other_power_law
    assert law is not None
    for truth, power in ((law.at(quadratic, np.array([1.0])), 1.0), (quadratic, 0.0)):
        found = Search(sample_of(truth, 16, seed=2), tuple(effects.values()), Hypothesis(World(cube))).run()
        h = found.hypothesis
        assert h.names[0] == "quadratic_drag"
        assert found.has_its_law("quadratic_drag") == (power == 0.0)
        assert (law.name in h.names) == (power == 1.0)
        if power:
            assert h.values_of(law.name)[0] == pytest.approx(1.0, abs=0.3)
            assert not found.has_its_law(law.name)
