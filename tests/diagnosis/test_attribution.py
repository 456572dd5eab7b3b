"""Whitened misses are noise at the truth, effects come back by name and value, and nothing is named of nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.tossed import seen
from tests.models.conftest import cube
from tossid.diagnosis.attribution import diagnose
from tossid.diagnosis.evidence import Evidence, Hypothesis
from tossid.diagnosis.fitting import fit
from tossid.diagnosis.judging import Judge, one_sided
from tossid.diagnosis.search import Found
from tossid.diagnosis.settling import walked, without_nothings
from tossid.diagnosis.whitening import linearise
from tossid.diagnosis.windows import make_windows
from tossid.objects import ObjectModel
from tossid.physics.effects import LIBRARY, Effect, Forces, Recording, World
from tossid.physics.forces import DRAG
from tossid.types import Phase

__all__ = ["cube"]

NAMES = {effect.name: effect for effect in LIBRARY}
FEW = [NAMES[name] for name in ("com_offset", "gravity", "friction", "restitution", "length_scale", "linear_drag")]


def evidence(world: World, cube: ObjectModel, tosses: list) -> Evidence:
    return Evidence(*linearise(make_windows(tosses), world))


def test_whitened_misses_are_noise_at_the_truth(cube: ObjectModel) -> None:
    world = World(cube)
    e = evidence(world, cube, seen(world, cube, 12, seed=0))
    residual = e.residual(world)
    free = np.isin(e.windows.phase, (Phase.FLIGHT, Phase.REST)) & e.windows.inside
    # the truth was simulated in eighths of the steps: after impacts that shows
    assert 0.8 < np.sqrt((residual[free] ** 2).mean()) < 1.3
    assert np.abs(residual[~e.windows.inside]).max(initial=0.0) == 0.0
    assert np.median(np.abs(residual[e.windows.inside])) < 0.8
    wrong = replace(world, gravity=8.5)
    assert np.abs(e.residual(wrong))[free].mean() > 1.5 * np.abs(residual)[free].mean()


@pytest.mark.parametrize(
    ("name", "truth", "tolerance"),
    [
        ("friction", [0.25], 0.004),
        ("com_offset", [2e-3, -3e-3, 5e-3], 8e-4),
        ("gravity", [9.3], 0.06),
        ("length_scale", [0.98], 2e-3),
    ],
)
def test_parameters_come_back(cube: ObjectModel, name: str, truth: list[float], tolerance: float) -> None:
    nominal = World(cube)
    effect = NAMES[name]
    tosses = seen(effect.at(nominal, np.array(truth)), cube, 16, seed=1)
    hypothesis, windows = Hypothesis(nominal).plus(effect), make_windows(tosses)
    evidence = Evidence(*linearise(windows, hypothesis.world(), refine=3))
    fitted = fit(evidence, hypothesis, n_tosses=len(tosses), iterations=12)
    np.testing.assert_allclose(fitted.hypothesis.flat(), truth, atol=tolerance)


def test_the_right_effect_is_named(cube: ObjectModel) -> None:
    truth = NAMES["friction"].at(World(cube), np.array([0.25]))
    found = diagnose(seen(truth, cube, 16, seed=2), World(cube), library=FEW)
    assert found.named == ("friction",)
    assert found.findings[0].verdict == "identified"
    mu = found.findings[0].parameters["mu"]
    assert mu.low - 0.002 < 0.25 < mu.high + 0.002
    assert found.gap_closed.value > 0.8
    slide = next(share for share in found.gap.by_phase if share.name == "slide")
    assert slide.share.value > 0.4


def test_nothing_is_named_of_nothing(cube: ObjectModel) -> None:
    found = diagnose(seen(World(cube), cube, 14, seed=3), World(cube), library=FEW)
    assert found.named == ()
    assert found.verdict == "no_gap"


@pytest.mark.parametrize("begin", [1.01, 1.05])
def test_an_effect_that_a_fit_cannot_reach_is_walked_to(cube: ObjectModel, begin: float) -> None:
    nominal = World(cube)
    geometry = NAMES["geometry"]
    judge = Judge.of(seen(geometry.at(nominal, np.array([1.03])), cube, 8, seed=9), cube, seed=0, n_threads=1)
    first, away = (judge.start(each) for each in (Hypothesis(nominal), Hypothesis(nominal).plus(geometry, [begin])))
    found = Found(first, away, (first, away), {}, {}, {"geometry": away}, {"geometry": ()})
    there = walked(judge, found)
    assert there.present.hypothesis.values_of("geometry") == pytest.approx(1.03, abs=1e-3)
    assert there.history == (first, there.present)
    # flight tells its own, and is not rough
    shown = replace(found, flown=1)
    assert walked(judge, shown) is shown


def test_what_is_nothing_once_tosses_are_cut_elsewhere_loses_its_name(cube: ObjectModel) -> None:
    """The ground is level: tilts that are found where tosses are cut first scatter about none."""
    nominal = World(cube)
    tosses = seen(NAMES["friction"].at(nominal, np.array([0.3])), cube, 10, seed=8)
    judge = Judge.of(tosses, cube, seed=0, n_threads=1)
    first = judge.start(Hypothesis(nominal))
    both = Hypothesis(nominal).plus(NAMES["ground_tilt"]).plus(NAMES["friction"])
    present = judge.judged(first, None, both)
    tilt, friction = (present.hypothesis.values_of(name) for name in ("ground_tilt", "friction"))
    assert np.abs(tilt).max() < 2e-3
    assert friction == pytest.approx(0.3, abs=0.01)
    of = {"ground_tilt": present, "friction": present}
    found = Found(first, present, (first, present), {}, {}, of, dict.fromkeys(of, ()))
    left, spread = without_nothings(judge, found, np.array([2e-3, 2e-3, 1e-3]))
    assert [effect.name for effect in left.present.hypothesis.effects] == ["friction"]
    assert left.history == (first, left.present)
    assert list(left.needed) == list(left.classes) == ["friction"]
    np.testing.assert_array_equal(spread, [1e-3])
    # of what flight has shown, contact has no say
    assert without_nothings(judge, replace(found, flown=1), np.array([2e-3, 2e-3, 1e-3]))[0].needed == of


def test_two_effects_are_both_named(cube: ObjectModel) -> None:
    truth = NAMES["gravity"].at(NAMES["friction"].at(World(cube), np.array([0.25])), np.array([9.2]))
    found = diagnose(seen(truth, cube, 16, seed=4), World(cube), library=FEW)
    assert set(found.named) == {"friction", "gravity"}


@pytest.mark.slow
def test_contact_decides_between_what_flight_cannot_tell_apart_once_it_is_right(cube: ObjectModel) -> None:
    """A missing bounce drowns the height at which a shorter unit of length lets the cube rest."""
    truth = replace(NAMES["restitution"].at(World(cube), np.array([0.35])), recording=Recording(length_scale=0.985))
    library = [NAMES[name] for name in ("gravity", "length_scale", "time_base", "restitution")]
    found = diagnose(seen(truth, cube, 16, seed=2), World(cube), library=library)
    assert set(found.named) == {"restitution", "length_scale"}
    bounce = next(each for each in found.findings if each.name == "restitution").parameters["e"]
    assert bounce.low < 0.35 < bounce.high


def test_an_effect_out_of_the_library_does_not_explain(cube: ObjectModel) -> None:
    truth = NAMES["restitution"].at(World(cube), np.array([0.5]))
    library: list[Effect] = [effect for effect in FEW if effect.name != "restitution"]
    found = diagnose(seen(truth, cube, 14, seed=5), World(cube), library=library)
    assert found.verdict != "explained"
    assert found.gap_closed.value < 0.6


def test_a_drag_of_another_power_has_no_name(cube: ObjectModel) -> None:
    """Its nearest in the library closes most of the gap, and is not it."""
    library = [NAMES[name] for name in ("linear_drag", "quadratic_drag", "gravity", "com_offset")]
    for power, named in ((2.0, ()), (1.0, ("quadratic_drag",))):
        forces = Forces(linear=0.12, powered=DRAG, power=power)
        found = diagnose(seen(World(cube, forces=forces), cube, 16, seed=7), World(cube), library=library)
        assert found.named == named
        assert (found.verdict == "unexplained") == (not named)
        for name, further in found.other_laws:
            assert (name, found.unexplained[0].name) == ("quadratic_drag", "flight")
            assert further.low < 1.0 < further.high
            # contact is looked at in the world of the force that was found
            assert further.low < found.hypothesis.base.forces.power < further.high
    assert not found.other_laws


def test_a_force_that_changes_from_toss_to_toss_has_no_name(cube: ObjectModel) -> None:
    """It pulls to one side, and so would its nearest in the library, which however is always the same."""
    library = [NAMES[name] for name in ("uniform_force", "gravity", "friction")]
    for force, named in ((np.linspace(0.03, 0.3, 18), ()), (np.full(18, 0.15), ("uniform_force",))):
        tosses = [seen(World(cube, forces=Forces(x=x)), cube, 1, seed=seed)[0] for seed, x in enumerate(force)]
        found = diagnose(tosses, World(cube), library=library)
        assert found.named == named
        assert found.unsteady == (() if named else ("uniform_force",))
        assert (found.verdict == "unexplained") == (not named)


def test_recording_effects_move_what_is_recorded(cube: ObjectModel) -> None:
    tosses = seen(World(cube, recording=Recording(clock_rate=1.02)), cube, 14, seed=6)
    found = diagnose(tosses, World(cube), library=[NAMES["time_base"], NAMES["friction"], NAMES["com_offset"]])
    assert found.named[0] == "time_base"
    assert found.findings[0].parameters["rate_rel"].value == pytest.approx(1.02, abs=2e-3)


def test_one_sided() -> None:
    assert one_sided(np.arange(1.0, 13.0)) == pytest.approx(2.0**-12)
    assert one_sided(np.append(np.arange(1.0, 13.0), -1e6)) < 0.1
    assert one_sided(np.array([-1.0, 1.1, -0.9, 0.8])) > 0.4
    assert one_sided(np.array([1.0, 2.0])) == 1.0
