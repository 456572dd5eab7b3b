"""Errors of objects with joints, and short rollouts, against what they are by hand."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.evaluation.metrics import score_tosses, score_windows, wrapped
from tossid.models.predictor import Simulator
from tossid.objects import OBJECT_FILES, ObjectModel, load_object
from tossid.physics import make_system, simulate
from tossid.settings.training import ModelSettings
from tossid.types import Toss

DT = 1 / 148


@pytest.fixture(scope="module")
def elbow() -> ObjectModel:
    return load_object(OBJECT_FILES / "elbow.xml")


@pytest.fixture(scope="module")
def flights(elbow: ObjectModel) -> list[Toss]:
    """Flights by the simulator that will predict them."""
    rng = np.random.default_rng(0)
    q = np.concatenate([np.tile([0, 0, 5.0], (3, 1)), rng.normal(size=(3, 4)), rng.normal(size=(3, 1))], axis=1)
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    steps = ModelSettings.substeps
    run = simulate(
        make_system(elbow), q, rng.normal(size=(3, 7)) * 3, n_steps=40, dt=DT, substeps=steps, impact_parts=8
    )
    cov, phase = np.tile(1e-9 * np.eye(7), (41, 1, 1)), np.zeros(41, dtype=np.uint8)
    return [Toss(str(i), np.arange(41) * DT, run.q[i], run.v[i], cov, cov, phase) for i in range(3)]


def test_the_truth_has_no_error_and_whole_turns_do_not_count(elbow: ObjectModel, flights: list[Toss]) -> None:
    predictor = Simulator(make_system(elbow))
    turned = []
    for toss in flights:
        q = toss.q.copy()
        q[:, 7] += 2 * np.pi
        turned.append(Toss(toss.name, toss.t, q, toss.v, toss.q_cov, toss.v_cov, toss.phase))
    for tosses in (flights, turned):
        scores = score_tosses(predictor, elbow, tosses)
        for value in (scores.joint_error_deg, scores.position_error_pct, scores.link_error_deg, scores.flight_miss_pct):
            np.testing.assert_allclose(value, 0, atol=1e-4)


def test_missing_frames_are_rolled_out_and_not_compared(elbow: ObjectModel, flights: list[Toss]) -> None:
    there = np.setdiff1d(np.arange(41), [3, 10, 11, 30])
    some = [
        Toss(toss.name, *(each[there] for each in (toss.t, toss.q, toss.v, toss.q_cov, toss.v_cov, toss.phase)))
        for toss in flights
    ]
    scores = score_tosses(Simulator(make_system(elbow)), elbow, some)
    np.testing.assert_allclose(scores.position_error_pct, 0, atol=1e-4)
    np.testing.assert_allclose(scores.link_error_deg, 0, atol=1e-4)


def test_the_error_in_flight_is_that_of_gravity(elbow: ObjectModel, flights: list[Toss]) -> None:
    q, v = flights[0].q, 0 * flights[0].v
    still = Toss("still", flights[0].t, q, v, flights[0].q_cov, flights[0].v_cov, flights[0].phase)
    scores = score_tosses(Simulator(make_system(elbow, gravity=0.9 * 9.81)), elbow, [still])
    assert scores.flight_miss_pct[0] == pytest.approx(10.0)


def test_recorded_poses_have_a_penetration_of_their_own(cube: ObjectModel) -> None:
    """A cube that is recorded 2 mm too low at rest: its rollout, lifted onto the ground, does not sink."""
    q = np.tile([0.0, 0.0, 0.5 * cube.width - 0.002, 1.0, 0.0, 0.0, 0.0], (20, 1))
    cov, phase = np.tile(1e-9 * np.eye(6), (20, 1, 1)), np.zeros(20, dtype=np.uint8)
    low = Toss("low", np.arange(20) * DT, q, np.zeros((20, 6)), cov, cov, phase)
    scores = score_tosses(Simulator(make_system(cube)), cube, [low])
    assert scores.recorded_penetration_mm[0] == pytest.approx(2.0)
    assert scores.penetration_mm[0] < 0.1


def test_short_rollouts_start_anew(elbow: ObjectModel, flights: list[Toss]) -> None:
    """With gravity off by d, the k-th frame is off by d (k dt)² / 2: over 16 steps from each start."""
    predictor = Simulator(make_system(elbow, gravity=9.31))
    short = score_windows(predictor, elbow, flights)
    frames = np.arange(17) * DT
    expected = 100 * (0.25 * frames**2).mean() / elbow.width
    np.testing.assert_allclose(short.position_error_pct, expected, rtol=0.02)
    assert (score_tosses(predictor, elbow, flights).position_error_pct > 3 * expected).all()
    assert np.isnan(score_windows(predictor, elbow, [*flights, flights[0].frames(slice(0, 9))]).position_error_pct[3])


def test_a_rotation_error_is_at_most_half_a_turn() -> None:
    np.testing.assert_allclose(wrapped(np.array([0.1, 2 * np.pi - 0.1, -3 * np.pi + 0.2])), [0.1, -0.1, -np.pi + 0.2])
