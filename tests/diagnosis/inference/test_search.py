"""The search names what tosses were made with, at its size, and nothing where nothing is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.conftest import FRICTION
from tests.diagnosis.tossed import POSITION, ROTATION, with_effect
from tossid.diagnosis.findings import Interval
from tossid.diagnosis.inference.final_values import (
    DEGREES,
    FINER,
    SHIFTS,
    FinalValues,
    final_values,
    precise,
    roots_between,
)
from tossid.diagnosis.inference.fitting import fit
from tossid.diagnosis.inference.found import Found, words
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.inference.search import Search
from tossid.diagnosis.inference.verdict import Facts, verdict_of_found, verdict_of_gap, verdict_of_others
from tossid.diagnosis.problem import Problem
from tossid.objects import ObjectModel
from tossid.physics.effects import World, effects_for
from tossid.types import Toss

SOME = tuple(
    EFFECTS[name]
    for name in ("gravity", "time_base", "com_offset", "body_frame_offset", "length_scale", "world_tilt", "friction",
                 "restitution", "cohesion", "compliance", "inertia", "linear_drag")
)  # fmt: skip


@pytest.fixture(scope="module")
def searched(cube: ObjectModel, stated: Hypothesis) -> Callable[..., Found]:
    return lambda sample, library=effects_for(cube): Search(sample, library, stated).run()


def test_friction_is_named_at_its_size(slippery: Sample, searched: Callable[..., Found]) -> None:
    found = searched(slippery)
    assert found.hypothesis.names == ("friction",)
    assert found.hypothesis.flat()[0] == pytest.approx(FRICTION, abs=0.005)
    assert found.needed["friction"].sum() > 100
    assert words(found.hypothesis).startswith("coulomb; friction 0.2")


def test_nothing_is_named_where_nothing_is(
    cube: ObjectModel, sample_of: Callable[..., Sample], searched: Callable[..., Found]
) -> None:
    found = searched(sample_of(World(cube), seed=11))
    assert found.hypothesis.names == ()
    assert found.needed == {}


def test_flight_finds_the_centre_of_mass_and_contact_tells_it_from_the_frame(
    cube: ObjectModel, sample_of: Callable[..., Sample], searched: Callable[..., Found]
) -> None:
    found = searched(sample_of(with_effect(cube, "com_offset", [0.0, 0.0, 0.006]), seed=5), SOME)
    assert found.hypothesis.names == ("com_offset",)
    assert found.flown == {"com_offset"}
    assert found.hypothesis.flat() == pytest.approx([0.0, 0.0, 0.006], abs=1e-3)
    rivals = {rival.effect.name: rival for rival in found.rivals["com_offset"]}
    assert not rivals["body_frame_offset"].is_alike
    # what flight has determined keeps its values
    assert final_values(found, ()) == FinalValues(found, {})


@pytest.mark.parametrize("seed", [4, 7])
def test_of_two_that_no_likelihood_tells_apart_the_library_first_one_stands(
    cube: ObjectModel, sample_of: Callable[..., Sample], searched: Callable[..., Found], seed: int
) -> None:
    """Rigid contact has no unit of time: a clock does what gravity does, whichever noise makes likelier."""
    found = searched(sample_of(World(cube, gravity=10.2), seed=seed), SOME)
    assert found.hypothesis.names == ("gravity",)
    assert found.hypothesis.flat()[0] == pytest.approx(10.2, abs=0.02)
    assert "time_base" in {rival.effect.name for rival in found.alike("gravity")}


def test_effects_of_flight_and_of_contact_are_both_named(
    cube: ObjectModel, sample_of: Callable[..., Sample], searched: Callable[..., Found]
) -> None:
    world = replace(with_effect(cube, "restitution", [0.3]), gravity=10.2)
    found = searched(sample_of(world, seed=6), SOME)
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
    for truth, power in ((law.at(quadratic, np.array([1.0])), 1.0), (quadratic, 0.0)):
        found = Search(sample_of(truth, 16, seed=2), tuple(effects.values()), Hypothesis(World(cube))).run()
        h = found.hypothesis
        assert h.names[0] == "quadratic_drag"
        assert found.has_its_law("quadratic_drag") == (power == 0.0)
        assert (law.name in h.names) == (power == 1.0)
        if power:
            assert h.values_of(law.name)[0] == pytest.approx(1.0, abs=0.3)
            assert not found.has_its_law(law.name)
            # what takes its place has its own law, and not the power that was fitted beside quadratic drag
            assert law.name not in h.with_replaced("quadratic_drag", EFFECTS["linear_drag"], np.array([0.1])).names


# ---------------------------------------------------------------- the values that are reported


def test_final_values_hold_the_truth_though_the_fit_was_off_it(slippery_tosses: list[Toss], stated: Hypothesis) -> None:
    problem = Problem(slippery_tosses[:9], stated, library=(EFFECTS["friction"],))
    samples = [problem.sample, *map(problem.shifted, SHIFTS)]
    assert all(len(s.windows.toss) != len(samples[0].windows.toss) or s.windows.first.min() > 0 for s in samples[1:])
    off = stated.plus(EFFECTS["friction"], np.array([FRICTION + 0.003]))
    coarse = problem.sample.evidence(off)
    fitted = fit(coarse, off, n=len(problem.tosses), iterations=0)
    final = final_values(Found(problem.sample.evidence(stated), fitted, None, ()), samples)
    there, variance = final.found.fit, final.variance["friction"]
    assert there.evidence.windows.settings.simulation.substeps == FINER * 2
    assert variance.shape == (1,)
    assert 0 < np.sqrt(variance[0]) < 0.01
    plain, wider = there.intervals("friction")["mu"], there.intervals("friction", variance, DEGREES)["mu"]
    assert wider.low < plain.low < plain.value < plain.high < wider.high
    assert wider.low < FRICTION < wider.high
    assert abs(plain.value - FRICTION) < 0.5 * 0.003
    # where steps are a share of a parameter's change, the jackknife is wider by that share
    alone = fit(there.evidence, there.hypothesis, n=there.n, iterations=0, sizes=there.sizes).intervals("friction")
    assert plain.high - plain.low > alone["mu"].high - alone["mu"].low
    # a variance of two degrees of freedom alone has their quantile, 4.3
    alone = there.intervals("friction", np.array([1e-3**2 * 1e4]), DEGREES)
    assert alone["mu"].high - alone["mu"].value == pytest.approx(4.303 * 0.1, rel=0.02)
    # shorter time steps change predictions by less than the poses' noise
    apart = np.abs((precise(coarse).raw - coarse.raw) / np.repeat([POSITION, ROTATION], 3)).max((1, 2))
    assert apart.max() > 1e-3
    assert np.median(apart) < 0.5


@pytest.mark.parametrize("ends", [(-3.0, 5.0), (1.0, 5.0)])
def test_roots_of_linear_steps_are_found_where_a_bound_is_in_the_way_too(ends: tuple[float, float]) -> None:
    """Steps that go a quarter and half of the way to 2 and -1, from ends that need not lie alike about either."""
    values = np.array([[[ends[0], 4.0], [ends[1], -2.0]]])
    found, share = roots_between(values, np.array([0.25, 0.5]) * (np.array([2.0, -1.0]) - values))
    np.testing.assert_allclose(found, [[2.0, -1.0]])
    np.testing.assert_allclose(share, [0.25, 0.5])


# ---------------------------------------------------------------- the tables of verdicts


SURE = Facts((), 1.0, False, 0.9)

CLOSED = Interval(0.9, 0.8, 1.0)


@pytest.mark.parametrize(
    ("changes", "verdict"),
    [
        ({}, "identified"),
        ({"alike": ("cohesion",)}, "confusable"),
        ({"frequency": 0.89}, "candidate"),
        ({"worsens": True}, "candidate"),
        ({"closes": 0.4}, "candidate"),
        ({"alike": ("cohesion",), "frequency": 0.5}, "candidate"),
        ({"frequency": None}, "identified"),
        ({"holds": False}, "candidate"),
    ],
)
def test_an_effect_that_was_found(changes: dict[str, Any], verdict: str) -> None:
    assert verdict_of_found(replace(SURE, **changes)) == verdict


def test_an_effect_that_was_not_found_would_have_been_or_not() -> None:
    ranges = {"x_m": 0.08, "c_nspm": 2.0}
    assert verdict_of_others({"x_m": 0.004}, ranges) == "not_supported"
    assert verdict_of_others({"x_m": 0.08}, ranges) == "not_identifiable"
    assert verdict_of_others({}, ranges) == "not_identifiable"


@pytest.mark.parametrize(
    ("changes", "verdict"),
    [
        ({}, "explained"),
        ({"felt": True}, "partly_explained"),
        ({"sure": False}, "partly_explained"),
        ({"sure": False, "closed": Interval(0.3, 0.1, 0.5)}, "unexplained"),
        ({"felt": True, "closed": Interval(0.3, 0.1, 0.5)}, "unexplained"),
        ({"found": False}, "unexplained"),
        ({"found": False, "within_solvers": True}, "within_solver_disagreement"),
        ({"found": False, "gap_over_floor": 1.1}, "no_gap"),
    ],
)
def test_the_whole_gap(changes: dict[str, Any], verdict: str) -> None:
    known: dict[str, Any] = {
        "found": True,
        "sure": True,
        "gap_over_floor": 4.0,
        "felt": False,
        "closed": CLOSED,
        "within_solvers": False,
    }
    assert verdict_of_gap(**(known | changes)) == verdict
