"""What tosses contradict is sought again, decided or demoted; what they do not is left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.tossed import seen
from tossid.diagnosis.findings import Interval
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.localisation.contradictions import (
    CheckByTosses,
    ask_tosses,
    contradicted_names,
    decided_by_witnesses,
    measured_values,
    stand_ins,
)
from tossid.diagnosis.localisation.rollouts import toss_errors
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.selection.search_result import SearchResult
from tossid.diagnosis.witness import Witness
from tossid.objects import ObjectModel
from tossid.physics.effects import World, effect_named
from tossid.types import Toss

SAID = Witness("rebound of a lone corner", "restitution", 0.0, 0.5, Interval(0.4, 0.39, 0.41), 20, None, True)
SLOW = Witness("friction of slow sliding", "friction", 0.18, 0.3, Interval(0.2, 0.19, 0.21), 9, None, True)
FAST = replace(SLOW, quantity="friction of fast sliding", measured=Interval(0.25, 0.24, 0.26), tosses=12)


def test_the_witness_of_most_tosses_says_the_value() -> None:
    assert measured_values([FAST, SAID, SLOW]) == {"friction": 0.25, "restitution": 0.4}
    assert measured_values([]) == {}


def test_a_witness_speaks_of_all_laws_of_its_phenomenon() -> None:
    names = ["cohesion", "compliance", "inertia", "wind"]
    assert contradicted_names([SAID, SLOW], names) == {"cohesion", "compliance"}
    assert contradicted_names([replace(SAID, contradicts=False)], names) == frozenset()


@pytest.mark.parametrize(
    ("measured", "there", "expected"),
    [
        (["restitution"], ["compliance", "friction"], {"compliance": "restitution"}),
        (["restitution"], ["compliance", "restitution"], {}),
        (["friction"], ["velocity_friction", "cohesion"], {}),
        (
            ["friction", "inertia"],
            ["cohesion", "rounded_corners"],
            {"cohesion": "friction", "rounded_corners": "inertia"},
        ),
        (["friction"], ["linear_drag"], {}),
        (["gravity"], ["compliance"], {}),
        ([], ["compliance"], {}),
    ],
)
def test_stand_ins_have_the_place_of_what_is_measured(
    measured: list[str], there: list[str], expected: dict[str, str]
) -> None:
    assert stand_ins(measured, [effect_named(name) for name in there]) == expected


@pytest.fixture(scope="module")
def bouncing(cube: ObjectModel) -> list[Toss]:
    """Tosses with a restitution of 0.4."""
    return seen(World(cube.with_changes(restitution=0.4)), cube, 24, seed=3, frames=120)


def test_objects_with_joints_have_no_witnesses(elbow: ObjectModel, bouncing: list[Toss], cube: ObjectModel) -> None:
    validator = CrossValidator.of(bouncing, cube, seed=0)
    assert ask_tosses(bouncing, World(elbow), World(elbow), validator) == ()


def test_tosses_contradict_a_bounce_that_they_do_not_have(cube: ObjectModel, bouncing: list[Toss]) -> None:
    """And whole tosses are predicted worse with it."""
    check = CheckByTosses(bouncing, World(cube), CrossValidator.of(bouncing, cube, seed=0))
    wrong, right = (World(cube.with_changes(restitution=e)) for e in (0.6, 0.4))
    assert check.contradicted(wrong)["restitution"] == pytest.approx(0.4, abs=0.02)
    assert "restitution" not in check.contradicted(right)
    assert check.measured(right)["restitution"] == pytest.approx(0.4, abs=0.02)
    assert check.errors(right).shape == (24, 2)
    assert np.median(check.errors(wrong)[:, 0]) > 3 * np.median(check.errors(right)[:, 0])


def test_whole_tosses_are_simulated_in_the_steps_of_the_settings(cube: ObjectModel, bouncing: list[Toss]) -> None:
    some, world = bouncing[:2], World(cube)
    default = CrossValidator.of(some, cube, seed=0)
    simulation = replace(default.settings.likelihood.simulation, substeps=12)
    settings = replace(default.settings, likelihood=replace(default.settings.likelihood, simulation=simulation))
    coarse, fine = (CheckByTosses(some, world, replace(default, settings=s)) for s in (default.settings, settings))
    assert np.array_equal(coarse.errors(world), toss_errors(some, world, n_threads=1))
    assert not np.array_equal(fine.errors(world), coarse.errors(world))


def test_a_class_is_led_by_what_tosses_do_not_contradict(cube: ObjectModel, bouncing: list[Toss]) -> None:
    """A restitution of 0.6 leads over one of 0.4 in a made search result."""
    validator = CrossValidator.of(bouncing, cube, seed=0)
    base, bounce = World(cube), effect_named("restitution")
    other = replace(bounce, name="another_law_of_restitution")

    def fitted(effect: object, e: float) -> object:
        hypothesis = Hypothesis(base, (effect,), (np.array([e]),))  # type: ignore[arg-type]
        return replace(validator.evaluate(hypothesis), effect=effect)  # type: ignore[type-var]

    first, leads, rival = validator.evaluate(Hypothesis(base)), fitted(bounce, 0.6), fitted(other, 0.4)
    found = SearchResult(
        first, leads, (first, leads), {}, {}, {bounce.name: leads}, {bounce.name: (rival,)}  # type: ignore[arg-type,dict-item]
    )  # fmt: skip

    def asked(at: World) -> tuple[Witness, ...]:
        return ask_tosses(bouncing, base, at, validator)

    against = [each for each in asked(leads.hypothesis.world()) if each.contradicts]  # type: ignore[attr-defined]
    assert measured_values(against)["restitution"] == pytest.approx(0.4, abs=0.02)
    decided = decided_by_witnesses(found, validator, asked)
    assert decided.present.hypothesis.names == (other.name,)
    assert [each.name for each in decided.classes[other.name]] == [bounce.name]
    assert set(decided.classes) == {other.name}
    assert set(decided.needed) == {other.name}
    same = decided_by_witnesses(decided, validator, asked)
    assert same is decided


@pytest.mark.parametrize(("n_flight", "leads"), [(0, "friction"), (1, "restitution")])
def test_a_class_of_flight_is_not_led_by_what_predicts_contact_worse(
    cube: ObjectModel, bouncing: list[Toss], n_flight: int, leads: str
) -> None:
    """A witness speaks against restitution, which these tosses have, and not against friction."""
    validator = CrossValidator.of(bouncing, cube, seed=0)
    base = World(cube)

    def of(name: str, value: float) -> Candidate:
        hypothesis = Hypothesis(base, (effect_named(name),), (np.array([value]),))
        return replace(validator.evaluate(hypothesis), effect=effect_named(name))

    first, present, rival = validator.evaluate(Hypothesis(base)), of("restitution", 0.4), of("friction", 0.2)
    needed, classes = {"restitution": present}, {"restitution": (rival,)}
    found = SearchResult(first, present, (first, present), {}, {}, needed, classes, n_flight)

    def asked(at: World) -> tuple[Witness, ...]:
        return (replace(SAID, contradicts=bool(at.object.restitution > 0)),)

    assert decided_by_witnesses(found, validator, asked).present.hypothesis.names == (leads,)
