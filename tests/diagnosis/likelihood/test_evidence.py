"""Whitened residuals are noise at the truth, for a single body and with a joint; gains are robust."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen, seen_with_joint, with_effect
from tossid.diagnosis.likelihood.evidence import FREE, Evidence, Hypothesis
from tossid.diagnosis.likelihood.whitening import linearise
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.objects import ObjectModel
from tossid.physics.effects import LIBRARY, World
from tossid.types import Phase

K = 7


@pytest.fixture(scope="module")
def evidence(cube: ObjectModel) -> Evidence:
    return Evidence(*linearise(make_windows(seen(World(cube), cube, 12, seed=0)), World(cube)))


def test_whitened_residuals_are_noise_at_the_truth(cube: ObjectModel, evidence: Evidence) -> None:
    world = World(cube)
    e = evidence
    residual = e.residuals(world)
    free = np.isin(e.windows.phase, (Phase.FLIGHT, Phase.REST)) & e.windows.inside
    # the truth was simulated in an eighth of the time step, which differs after impacts
    assert 0.8 < np.sqrt((residual[free] ** 2).mean()) < 1.3
    assert np.abs(residual[~e.windows.inside]).max(initial=0.0) == 0.0
    assert np.median(np.abs(residual[e.windows.inside])) < 0.8
    wrong = replace(world, gravity=8.5)
    assert np.abs(e.residuals(wrong))[free].mean() > 1.5 * np.abs(residual)[free].mean()


def test_whitened_residuals_with_a_joint_are_noise_at_the_truth(elbow: ObjectModel) -> None:
    world = with_effect(elbow, "joint_damping", [2e-3])
    tosses = seen_with_joint(world, elbow, 10, seed=1, frames=24, height=0.1)
    windows, whitening = linearise(make_windows(tosses, elbow), world, refine=6)
    assert windows.channels == K
    r = Evidence(windows, whitening).residuals(world)[windows.inside]
    assert r.shape[1] == K
    np.testing.assert_allclose(r.std(axis=0), 1.0, atol=0.15)


def test_a_hypothesis_is_its_base_world_with_all_effects(cube: ObjectModel) -> None:
    both = Hypothesis(World(cube)).plus(EFFECTS["com_offset"], np.array([1e-3, 0.0, 0.0])).plus(EFFECTS["gravity"])
    assert both.world().object.com[0, 0] == pytest.approx(cube.com[0, 0] + 1e-3)
    assert both.world().gravity == World(cube).gravity
    assert both.place_of("gravity") == slice(3, 4)
    moved = both.at(np.array([0.0, 0.0, 2e-3, 9.5]))
    np.testing.assert_array_equal(moved.values_of("com_offset"), [0.0, 0.0, 2e-3])
    assert moved.minus("com_offset").world().gravity == 9.5
    low, high = both.bounds
    np.testing.assert_array_equal(both.clipped(np.full(4, 1e9)).flat(), high)
    np.testing.assert_array_equal(both.clipped(np.full(4, -1e9)).flat(), low)


def test_scales_are_the_size_of_the_residuals_in_each_phase(evidence: Evidence) -> None:
    rng = np.random.default_rng(0)
    size = np.where(evidence.windows.phase == Phase.SLIDE, 5.0, 1.0)[..., None]
    residuals = size * rng.standard_t(4, size=evidence.windows.noise.shape)
    scales = evidence.scales(residuals)
    assert scales[Phase.SLIDE] == pytest.approx(5.0, rel=0.1)
    assert scales[Phase.FLIGHT] == pytest.approx(1.0, rel=0.1)


def test_rows_of_an_unknown_phase_are_no_free_flight(evidence: Evidence) -> None:
    windows = evidence.windows
    unknown = replace(evidence, windows=replace(windows, phase=np.zeros_like(windows.phase)))
    residuals = np.where(windows.free[:, None, None], 3.0, 50.0) * np.ones(windows.noise.shape)
    free, *others = unknown.scales(residuals)
    assert free == pytest.approx(evidence.scales(residuals)[FREE])
    assert others == [1.0] * len(others)


def test_a_gain_is_linear_when_small_and_logarithmic_when_large(evidence: Evidence) -> None:
    small, large = evidence.gains(np.array([0.1, 1e4]), np.zeros(2))
    assert small == pytest.approx(0.1, rel=1e-3)
    assert large == pytest.approx(8 * np.log(2 * 1e4 / 8), rel=1e-3)


@pytest.mark.parametrize("name", [e.name for e in LIBRARY if Phase.FLIGHT not in e.phases])
def test_windows_that_do_not_feel_contact_are_predicted_as_if_they_were_simulated(
    name: str, cube: ObjectModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    windows = make_windows(seen(World(cube), cube, 8, seed=0), cube)
    evidence = Evidence(*linearise(windows, World(cube))).relinearised(World(cube))
    start = Hypothesis(World(cube)).plus(EFFECTS[name])
    low, high = start.bounds
    moved = start.at(np.clip(start.flat() + 10 * start.steps, low, high)).world()
    simulated: list[int] = []
    whole = World.roll_out

    def counted(self: World, q0: np.ndarray, v0: np.ndarray, **how: Any) -> np.ndarray:
        simulated.append(len(q0))
        return whole(self, q0, v0, **how)

    monkeypatch.setattr(World, "roll_out", counted)
    found = evidence.predicted(moved)
    asked = sum(simulated)
    expected = evidence.windows.residuals(evidence.windows.predicted(moved))
    np.testing.assert_allclose(found, expected, atol=1e-10)
    if name in ("ground_tilt", "rotation_delay"):  # gravity of another direction, another time: all are simulated
        assert asked == len(found)
    else:
        assert 0 < asked < 0.85 * len(found)
    evidence.predicted(moved)
    assert sum(simulated) == asked + len(found)


def test_predictions_do_not_depend_on_what_was_asked_for_before(cube: ObjectModel) -> None:
    """To the bit: where contact is rough, a difference of 1e-12 standard deviations ends in another answer."""
    windows = make_windows(seen(World(cube), cube, 8, seed=0), cube)
    evidence = Evidence(*linearise(windows, World(cube))).relinearised(World(cube))
    start = Hypothesis(World(cube)).plus(EFFECTS["linear_drag"]).plus(EFFECTS["rounded_corners"])
    flies = np.array([owner == "linear_drag" for owner in start.parameter_owners])
    moves = [np.where(flies, *move) * start.steps for move in ((1.0, 0.0), (1.0, 5.0), (0.0, 5.0), (1.0, 9.0))]
    worlds = [start.at(start.flat() + move).world() for move in moves]
    rows = np.arange(len(windows.steps))
    alone = [replace(evidence, known={}).predicted(each) for each in worlds]
    for each, expected in zip(reversed(worlds), reversed(alone), strict=True):
        np.testing.assert_array_equal(replace(evidence, known={}).predicted(each, rows), expected)
        np.testing.assert_array_equal(evidence.predicted(each), expected)


def test_a_restart_that_has_failed_is_not_repeated(cube: ObjectModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tosses of friction 0.4 under 0.18: windows that slide fit poorly, whatever their first states are."""
    slippery = cube.with_changes(friction=np.full_like(cube.friction, 0.4))
    windows, world = make_windows(seen(World(slippery), cube, 8, seed=0), cube), World(cube)
    simulated: list[int] = []
    whole = World.roll_out

    def counted(self: World, q0: np.ndarray, v0: np.ndarray, **how: Any) -> np.ndarray:
        simulated.append(len(q0))
        return whole(self, q0, v0, **how)

    begun = Evidence(*linearise(windows, world, refine=6))
    monkeypatch.setattr(World, "roll_out", counted)
    tried = begun.relinearised(world, refine=2, restarts=1)
    first = sum(simulated)
    assert np.isfinite(tried.whitening.given_up).sum() > 3
    tried.relinearised(world, refine=2, restarts=1)
    assert sum(simulated) - first < 0.6 * first
