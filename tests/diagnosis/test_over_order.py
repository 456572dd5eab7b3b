"""What changes over the order of recording is found with its form, place and size; it is undone or said."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import sample_of, seen, with_effect
from tossid.diagnosis.correction import corrected
from tossid.diagnosis.inference.designs import line_over, steps_at
from tossid.diagnosis.inference.fitting import Fit
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.order import OverOrder, over_order
from tossid.diagnosis.inference.screening import Screening, screen
from tossid.diagnosis.inference.stretches import Change, fitted_together
from tossid.diagnosis.over_order import (
    Undone,
    changes_left,
    corrections,
    findings_over_order,
    without_changes,
)
from tossid.diagnosis.problem import Problem
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.types import Toss

LIBRARY = tuple(EFFECTS[name] for name in ("friction", "gravity", "inertia", "world_tilt"))


def tosses_of(cube: ObjectModel, worlds: Sequence[World], frames: int = 60, *, seed: int = 100) -> tuple[Toss, ...]:
    made = (seen(world, cube, 1, seed=seed + k, frames=frames)[0] for k, world in enumerate(worlds))
    return tuple(replace(toss, name=f"t{k}") for k, toss in enumerate(made))


def beside_nothing(cube: ObjectModel, tosses: Sequence[Toss], stated: Hypothesis) -> tuple[Fit, Screening]:
    sample = sample_of(tosses, cube)
    first = sample.evidence(stated)
    screening = screen(first, LIBRARY, n=sample.n, rng=np.random.default_rng(0))
    return sample.evaluated(first), screening


def test_a_step_is_found_at_its_place_with_its_size(cube: ObjectModel, stated: Hypothesis) -> None:
    """24 tosses; before the eleventh the ground was cleaned."""
    cleaned = tosses_of(cube, [World(cube)] * 10 + [with_effect(cube, "friction", [0.26])] * 14)
    present, screening = beside_nothing(cube, cleaned, stated)
    found = over_order(present, screening)
    (change,) = fitted_together(present.evidence, found.changes)
    assert (change.effect.name, change.form) == ("friction", "steps")
    assert [stretch.first for stretch in change.stretches] == [0, 10]
    before, after = (stretch.values["mu"] for stretch in change.stretches)
    assert before.value == pytest.approx(0.18, abs=0.01)
    assert after.value == pytest.approx(0.26, abs=0.01)
    assert after.low - 0.003 < 0.26 < after.high + 0.003
    assert change.p_value <= 0.005
    assert change.values[:, 0].tolist() == pytest.approx([before.value] * 10 + [after.value] * 14)
    assert found.left > 0.005
    assert found.place is None


def test_a_drift_has_its_rate(cube: ObjectModel, stated: Hypothesis) -> None:
    worlds = [with_effect(cube, "gravity", [9.81 - 0.04 * k]) for k in range(20)]
    found = over_order(*beside_nothing(cube, tosses_of(cube, worlds), stated))
    (change,) = found.changes
    assert (change.effect.name, change.form) == ("gravity", "drift")
    rate = change.rate["g_ms2"]
    assert rate.low - 0.003 < -0.04 < rate.high + 0.003
    assert rate.value == pytest.approx(-0.04, abs=0.004)
    first, last = (stretch.values["g_ms2"].value for stretch in change.stretches)
    assert (first, last) == pytest.approx((9.81, 9.05), abs=0.06)


def test_nothing_changes_where_an_effect_is_in_all_tosses(cube: ObjectModel, stated: Hypothesis) -> None:
    found = over_order(*beside_nothing(cube, tosses_of(cube, [with_effect(cube, "friction", [0.26])] * 16), stated))
    assert found.changes == ()
    assert found.left > 0.005


N = 18
TILT = [0.03, -0.02]


def stepping(name: str, at: int, values: list[list[float]]) -> Change:
    B = np.array(values)
    return Change(EFFECTS[name], (0, at, N), 0.001, 50.0, steps_at((0, at, N)), B, np.zeros((B.size, B.size)))


def test_steps_at_different_tosses_are_fitted_together(cube: ObjectModel, stated: Hypothesis) -> None:
    slippery = with_effect(cube, "friction", [0.26])
    both = EFFECTS["world_tilt"].at(slippery, np.array(TILT))
    tosses = tosses_of(cube, [World(cube)] * 6 + [slippery] * 6 + [both] * 6)
    sample = sample_of(tosses, cube)
    begun = [stepping("friction", 6, [[0.2], [0.24]]), stepping("world_tilt", 12, [[0.002, 0.0], [0.025, -0.016]])]
    friction, tilt = fitted_together(sample.evidence(stated), begun)
    assert [(s.first, s.stop) for s in friction.stretches] == [(0, 6), (6, N)]
    truth = [(friction, "mu", [0.18, 0.26]), (tilt, "x_rad", [0.0, TILT[0]]), (tilt, "y_rad", [0.0, TILT[1]])]
    for change, key, values in truth:
        for stretch, true in zip(change.stretches, values, strict=True):
            found = stretch.values[key]
            half = found.high - found.value
            # no interval of few tosses is sure to hold: five of its standard errors are
            assert abs(found.value - true) < 2 * half + 1e-4
            assert 0 < half < (0.02 if key == "mu" else 2e-3)
    np.testing.assert_allclose(tilt.values[:12], np.tile([0.0, 0.0], (12, 1)), atol=5e-4)
    np.testing.assert_allclose(tilt.values[12:], np.tile(TILT, (6, 1)), atol=5e-4)
    assert friction.values[5, 0] == pytest.approx(friction.stretches[0].values["mu"].value)


def test_means_over_the_order_and_what_all_tosses_have_beside() -> None:
    """Variances of linear combinations of coefficients, by Student's t of the tosses that determine them."""
    n, cov = 40, np.diag([0.01, 0.04]) ** 2
    steps = Change(EFFECTS["friction"], (0, 10, n), 0.001, 9.0, steps_at((0, 10, n)), np.array([[0.2], [0.3]]), cov)
    mean = steps.mean()["mu"]
    assert mean.value == pytest.approx(0.275)
    assert mean.high - mean.value == pytest.approx(t.ppf(0.975, 38) * np.hypot(0.25 * 0.01, 0.75 * 0.04))
    first, last = (stretch.values["mu"] for stretch in steps.stretches)
    assert first.high - first.value == pytest.approx(t.ppf(0.975, 9) * 0.01)
    assert last.high - last.value == pytest.approx(t.ppf(0.975, 29) * 0.04)
    assert steps.shifted(np.array([0.05])).values[[0, -1], 0].tolist() == pytest.approx([0.25, 0.35])
    n, cov = 21, np.diag([0.01, 0.002]) ** 2
    drift = Change(EFFECTS["friction"], None, 0.001, 9.0, line_over(n), np.array([[0.3], [0.01]]), cov)
    half = {key: x["mu"].high - x["mu"].value for key, x in (("mean", drift.mean()), ("rate", drift.rate))}
    assert half == pytest.approx({"mean": t.ppf(0.975, 19) * 0.01, "rate": t.ppf(0.975, 19) * 0.002})
    end = drift.stretches[-1].values["mu"]
    assert end.value == pytest.approx(0.4)
    assert end.high - end.value == pytest.approx(t.ppf(0.975, 19) * np.hypot(0.01, 10 * 0.002))
    assert drift.shifted(np.array([0.05])).values[[0, 10, 20], 0].tolist() == pytest.approx([0.25, 0.35, 0.45])


# ---------------------------------------------------------------- undone or said


OF_RECORDING = tuple(EFFECTS[name] for name in ("world_tilt", "friction", "length_scale"))


@pytest.fixture(scope="module")
def recorded(cube: ObjectModel) -> tuple[Toss, ...]:
    """Of a slippery cube with its centre of mass elsewhere; before the tenth the camera was tilted."""
    same = EFFECTS["com_offset"].at(with_effect(cube, "friction", [0.26]), np.array([0.004, 0.0, -0.004]))
    return tosses_of(cube, [same] * 9 + [EFFECTS["world_tilt"].at(same, np.array(TILT))] * 9, seed=30)


@pytest.fixture(scope="module")
def bumped(cube: ObjectModel, recorded: tuple[Toss, ...]) -> Undone:
    """Two of them, one of each session, are unseen."""
    library = tuple(EFFECTS[name] for name in ("world_tilt", "friction", "com_offset"))
    names = tuple(toss.name for toss in recorded)
    some = Problem((*recorded[:3], *recorded[4:17]), Hypothesis(World(cube)), library=library, names=names)
    return without_changes(replace(some, unseen=(recorded[3], recorded[17]), sessions=("t9",)).in_order())


def test_a_tilt_is_undone_beside_what_all_tosses_have(
    bumped: Undone, recorded: tuple[Toss, ...], cube: ObjectModel
) -> None:
    """Fitted alone, it would take half a milliradian of what the centre of mass does."""
    (change,) = bumped.changes
    assert (change.effect.name, [s.first for s in change.stretches]) == ("world_tilt", [0, 8])
    np.testing.assert_allclose(change.values[[0, -1]], [[0.0, 0.0], TILT], atol=2e-4)
    assert set(bumped.found.hypothesis.names) == {"com_offset", "friction"}
    assert bumped.found.hypothesis.values_of("friction")[0] == pytest.approx(0.26, abs=0.01)
    assert bumped.left.changes == ()
    assert bumped.left.left > 0.005
    right = corrected(recorded[17], with_effect(cube, "world_tilt", TILT), World(cube))
    np.testing.assert_allclose(bumped.problem.unseen[1].q[:, :3], right.q[:, :3], atol=1e-3)


def test_what_was_undone_is_said(bumped: Undone, recorded: tuple[Toss, ...]) -> None:
    seen_ones = (*recorded[:3], *recorded[4:17])
    (finding,) = findings_over_order(bumped, seen_ones)
    assert (finding.name, finding.verdict) == ("world_tilt", "identified")
    over = finding.over_order
    assert over.undone
    assert [(s.first, s.last, s.n_tosses) for s in over.stretches] == [("t0", "t8", 8), ("t9", "t16", 8)]
    assert finding.parameters["x_rad"].value == pytest.approx(TILT[0] / 2, abs=1e-3)
    assert finding.stated == {"x_rad": 0.0, "y_rad": 0.0}
    assert finding.matters
    assert 0.0 < finding.gap_closed.value < 1.0
    assert finding.as_json()["sessions"][1]["first"] == "t9"
    assert changes_left(bumped, seen_ones) == ()
    (text,) = corrections(bumped).values()
    assert text.startswith("tosses t0 to t8: ")
    assert "; tosses t9 to t16: " in text


def test_friction_that_steps_is_left_and_said(cube: ObjectModel) -> None:
    tosses = tosses_of(cube, [World(cube)] * 8 + [with_effect(cube, "friction", [0.26])] * 8, seed=30)
    problem = Problem(tosses, Hypothesis(World(cube)), library=OF_RECORDING, sessions=("t8",)).in_order()
    undone = without_changes(problem)
    assert undone.changes == ()
    assert undone.problem is problem
    (change,) = undone.left.changes
    assert (change.effect.name, [s.first for s in change.stretches]) == ("friction", [0, 8])
    (finding,) = findings_over_order(undone, tosses)
    assert not finding.over_order.undone
    assert finding.parameters["mu"].value == pytest.approx(0.22, abs=0.01)
    assert corrections(undone) == {}


def test_what_all_tosses_have_of_an_effect_joins_its_change(cube: ObjectModel) -> None:
    worlds = [with_effect(cube, "world_tilt", [x, 0.0]) for x in [0.005] * 8 + [0.017] * 8]
    problem = Problem(tosses_of(cube, worlds, seed=30), Hypothesis(World(cube)), library=OF_RECORDING[:1])
    undone = without_changes(problem.in_order())
    (change,) = undone.changes
    np.testing.assert_allclose(change.values[[0, -1], 0], [0.005, 0.017], atol=5e-4)
    assert [s.values["x_rad"].value for s in change.stretches] == pytest.approx([0.005, 0.017], abs=5e-4)
    assert undone.found.hypothesis.names == ()


def test_tosses_come_in_the_order_of_their_recording_and_few_are_not_looked_at(cube: ObjectModel) -> None:
    tosses = tosses_of(cube, [World(cube)] * 6, frames=40)
    a, b, c = tosses[:3]
    some = Problem((c, a), Hypothesis(World(cube)), unseen=(b,), names=("t0", "t1", "t2"))
    assert [toss.name for toss in some.in_order().tosses] == ["t0", "t2"]
    assert replace(some, names=()).in_order().names == ("t2", "t0", "t1")
    undone = without_changes(Problem(tosses, Hypothesis(World(cube)), library=OF_RECORDING).in_order())
    assert undone.left == OverOrder((), None, None)
    assert changes_left(undone, tosses) is None
    assert findings_over_order(undone, tosses) == ()


def test_a_tilt_between_stretches_is_no_slow_error(cube: ObjectModel) -> None:
    tilted = with_effect(cube, "world_tilt", [0.03, 0.0])
    tosses = tosses_of(cube, [World(cube)] * 10 + [tilted] * 10, frames=140)
    right = (*tosses[:10], *(corrected(toss, tilted, World(cube)) for toss in tosses[10:]))
    problem = Problem(tosses, Hypothesis(World(cube))).in_order()
    whole, within = (np.abs(problem.windows_of(tosses, each).slow).max() for each in (tosses, right))
    assert within < 0.5 * whole
