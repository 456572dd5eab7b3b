"""What is said of a training: convergence, corners that no toss has shown, and a stated size that tosses contradict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.models.made import tosses
from tossid.models.trained import EpochRecord
from tossid.motion import MeasurementModel, estimate_measurement
from tossid.objects import ObjectModel, corner_positions
from tossid.settings.training import TrainSettings
from tossid.training.report import convergence, geometry_report, seen_corners, size_contradiction
from tossid.types import Phase, Toss


@pytest.fixture(scope="module")
def made(cube: ObjectModel) -> list[Toss]:
    return tosses(cube, 32, seed=3)


def reasons(model: ObjectModel, losses: np.ndarray = np.zeros(0), epochs: int = 20) -> str:
    """Why a training has not converged, of its model and the losses of its last stage."""
    history = [EpochRecord("contact", k + 1, x, x, {}, 1, 0.0, best=True) for k, x in enumerate(losses)]
    found = convergence(model, "not checked", history, (), TrainSettings(epochs=epochs))
    assert found["converged"] == (not found["reasons"])
    assert found["geometry_checked"] == "not checked"
    return "; ".join(found["reasons"])


def test_what_has_not_converged_is_said(cube: ObjectModel) -> None:
    """Friction at its end, a body that no mass within the corners has, and a loss that still fell at the end."""
    shell = cube.mass[0] * 2 / 3 * 3 * (0.5 * cube.width) ** 2 * np.eye(3)[None]  # all mass in the corners
    assert reasons(cube.with_changes(inertia=shell)) == ""
    assert "friction ran to 7e-05" in reasons(cube.with_changes(friction=7e-5))
    assert "more inertia" in reasons(cube.with_changes(inertia=1.2 * shell))
    assert "outside its corners" in reasons(cube.with_changes(com=np.array([[0.0, 0.0, 0.6 * cube.width]])))
    falling = 0.9 ** np.arange(20)
    assert "still fell" in reasons(cube, falling)
    assert reasons(cube, np.ones(20)) == reasons(cube, falling, epochs=40) == ""


def test_corners_that_no_toss_brought_down_are_marked(cube: ObjectModel, made: list[Toss]) -> None:
    q = made[0].q[:40].copy()
    q[:, 3:7], q[:, 2] = (1.0, 0.0, 0.0, 0.0), 0.5 * cube.width
    flat = replace(made[0].frames(slice(0, 40)), q=q)
    seen = seen_corners(cube, [flat] * 3)
    assert seen.tolist() == (cube.corner_pos[:, 2] < 0).tolist()
    assert not seen_corners(cube, [flat] * 2).any()  # however long, a rest is one contact
    flying = replace(flat, phase=np.full(len(flat.t), int(Phase.FLIGHT), dtype=np.uint8))
    assert not seen_corners(cube, [flying] * 3).any()
    assert seen_corners(cube, made).all()
    report = geometry_report(cube, seen, length_scale=0.5)
    assert len(report) == 1
    np.testing.assert_allclose(report[0]["vertices_m"], 0.5 * cube.corner_pos, atol=1e-6)
    assert report[0]["seen"] == seen.tolist()


def test_a_corner_that_sinks_in_flight_is_not_seen(cube: ObjectModel, made: list[Toss]) -> None:
    corners = cube.corner_pos.copy()
    corners[0] *= 1.8
    wrong = cube.with_changes(corner_pos=corners)
    flights = []
    for toss in made:
        low = corner_positions(cube, toss.q)[..., 2].min(axis=1)
        first = int(np.argmax(low < 1e-3)) if (low < 1e-3).any() else len(low)
        phase = np.full(first, int(Phase.FLIGHT), dtype=np.uint8)
        flights.append(replace(toss.frames(slice(first)), phase=phase))
    below = sum((corner_positions(wrong, toss.q)[:, 0, 2] < 0).sum() for toss in flights)
    assert below >= 3
    assert not seen_corners(wrong, flights).any()


def test_where_corners_came_from_is_listed_by_body(elbow: ObjectModel) -> None:
    seen = np.ones(elbow.n_corners, dtype=bool)
    history = [elbow.corner_pos + 0.02, elbow.corner_pos + 0.01, elbow.corner_pos]
    report = geometry_report(elbow, seen, length_scale=2.0, history=history)
    for body, link in enumerate(report):
        np.testing.assert_allclose(link["way_m"][0], 2 * history[0][elbow.corner_body == body], atol=1e-6)
        assert len(link["way_m"]) == 3
    assert all(not link["way_m"] for link in geometry_report(elbow, seen, length_scale=2.0, history=history[:1]))


def resting(cube: ObjectModel, width: float, count: int) -> list[Toss]:
    """Cubes of a width that lie on a face, with 0.1 mm of noise."""
    rng = np.random.default_rng(0)
    zero, phase = np.zeros((5, 6, 6)), np.zeros(5, dtype=np.uint8)
    found = []
    for number in range(count):
        q = np.tile([0.0, 0.0, 0.5 * width + 1e-4 * rng.normal(), 1.0, 0.0, 0.0, 0.0], (5, 1))
        found.append(Toss(f"{number}", np.arange(5) / 148, q, np.zeros((5, 6)), zero, zero, phase))
    return found


@pytest.mark.parametrize("ratio", [0.95, 1.1])
def test_a_size_that_tosses_contradict_is_said_with_its_figure(cube: ObjectModel, ratio: float) -> None:
    estimate = estimate_measurement(resting(cube, ratio * cube.width, 12), cube)
    found = size_contradiction(estimate, MeasurementModel())
    assert found["shown_over_stated"] == pytest.approx(ratio, abs=2e-3)
    assert found["ci95"][0] < ratio < found["ci95"][1]
    assert f"{100 * abs(ratio - 1):.0f}." in found["warning"]
    assert ("larger" if ratio > 1 else "smaller") in found["warning"]
    assert "learned corners take it up" in found["warning"]
    scaled = size_contradiction(estimate, MeasurementModel(length_scale=ratio))
    assert f"divides recorded lengths by {ratio:.4f}" in scaled["warning"]


def test_a_right_size_and_a_size_that_few_tosses_show_say_nothing(cube: ObjectModel) -> None:
    exact = MeasurementModel()
    assert size_contradiction(estimate_measurement(resting(cube, 1.005 * cube.width, 12), cube), exact) is None
    few = estimate_measurement(resting(cube, 1.1 * cube.width, 4), cube)
    assert size_contradiction(few, exact) is None
    sure = estimate_measurement(resting(cube, 1.1 * cube.width, 12), cube)
    assert size_contradiction(replace(sure, length_scale_ci95=(0.9, 1.3)), exact) is None
