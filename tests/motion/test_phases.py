"""Phases of motions whose phases are known by construction, and of real tosses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.motion.bouncing import bounce
from tossid.errors import MotionError
from tossid.motion import label_phases
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp, quat_mul
from tossid.store import read_contactnets
from tossid.types import Phase

H = 1 / 148
HALF = 0.0524


def still(n: int, height: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    q = np.zeros((n, 7))
    q[:, 2], q[:, 3] = height, 1.0
    return np.arange(n) * H, q, np.zeros((n, 6))


def test_a_thrown_cube_is_in_flight(cube: ObjectModel) -> None:
    t, q, v = still(30, 0.5)
    v[:] = [1.0, 0.5, 1.0, 3.0, -2.0, 8.0]
    v[:, 2] -= 9.81 * t
    q[:, :3] += np.array([1.0, 0.5, 1.0]) * t[:, None]
    q[:, 2] -= 4.905 * t**2
    q[:, 3:7] = quat_exp(v[:, 3:] * t[:, None])
    assert (label_phases(cube, t, q, v) == Phase.FLIGHT).all()


def test_a_lying_cube_rests(cube: ObjectModel) -> None:
    t, q, v = still(20, HALF)
    assert (label_phases(cube, t, q, v) == Phase.REST).all()


def test_a_braking_cube_slides_then_rests(cube: ObjectModel) -> None:
    t, q, v = still(120, HALF)
    v[:, 0] = np.maximum(1.0 - 0.18 * 9.81 * t, 0.0)
    q[1:, 0] = np.cumsum(v[1:, 0]) * H
    phase = label_phases(cube, t, q, v)
    stop = np.argmax(v[:, 0] <= 0.05)
    assert (phase[:stop] == Phase.SLIDE).all()
    assert (phase[stop:] == Phase.REST).all()


def test_a_cube_that_tips_over_its_edge_rolls(cube: ObjectModel) -> None:
    t, q, v = still(25, HALF)
    # about the edge at x = +half, z = 0, at 2 rad/s
    q[:, 3:7] = quat_exp(np.array([0.0, 2.0, 0.0]) * t[:, None])
    edge = np.array([HALF, 0.0, 0.0])
    arm = np.array([-HALF, 0.0, HALF])
    R = np.stack([np.cos(2 * t), np.sin(2 * t)])
    q[:, 0] = edge[0] + R[0] * arm[0] + R[1] * arm[2]
    q[:, 2] = -R[1] * arm[0] + R[0] * arm[2]
    v[:, 4] = 2.0
    v[:, 0], v[:, 2] = 2.0 * q[:, 2], -2.0 * (q[:, 0] - edge[0])
    assert (label_phases(cube, t, q, v) == Phase.ROLL).all()


def test_a_spinning_cube_slides_on_its_corners(cube: ObjectModel) -> None:
    t, q, v = still(25, HALF)
    v[:, 5] = 3.0
    q[:, 3:7] = quat_exp(v[:, 3:] * t[:, None])
    assert (label_phases(cube, t, q, v) == Phase.SLIDE).all()


def test_a_dropped_cube_meets_the_ground_once(cube: ObjectModel) -> None:
    drop = 0.1
    t, q, v = still(60, HALF + drop)
    fall = np.sqrt(2 * drop / 9.81)
    flying = t < fall
    v[flying, 2] = -9.81 * t[flying]
    q[:, 2] = np.where(flying, HALF + drop - 4.905 * t**2, HALF)
    phase = label_phases(cube, t, q, v)
    hit = int(np.argmin(flying))
    assert (phase[:hit] == Phase.FLIGHT).all()
    assert phase[hit] == Phase.IMPACT
    assert (phase[hit + 1 :] == Phase.REST).all()


def test_a_jump_far_above_the_ground_is_no_impact(cube: ObjectModel) -> None:
    t, q, v = still(10, 1.0)
    v[:, 2] = -9.81 * t
    v[5:, 0] = 1.0
    assert (label_phases(cube, t, q, v) == Phase.FLIGHT).all()


def test_impacts_of_bouncing_cubes_are_found(cube: ObjectModel) -> None:
    found = flights = 0
    for truth in bounce(cube, np.random.default_rng(0), tosses=8, frames=80):
        phase = label_phases(cube, truth.t, truth.q, truth.v)
        step = np.diff(truth.v, axis=0)
        step[:, 2] += 9.81 * H
        hard = np.linalg.norm(step[:, :3], axis=1) > 0.3
        assert (phase[1:][hard] == Phase.IMPACT).all()
        found += int(hard.sum())
        first = int(np.argmax(truth.contact))
        assert (phase[: first + 1] == Phase.FLIGHT).all()
        flights += first
        assert not (phase[1:][~truth.contact] == Phase.IMPACT).any()
    assert found > 15
    assert flights > 100


def test_noise_is_not_taken_for_impacts(cube: ObjectModel) -> None:
    rng = np.random.default_rng(0)
    t, q, v = still(200, HALF)
    v += rng.normal(size=v.shape) * 0.1 * np.array([1, 1, 1, 20, 20, 20])
    assert (label_phases(cube, t, q, v) == Phase.IMPACT).any()
    assert not (label_phases(cube, t, q, v, v_sigma=0.24) == Phase.IMPACT).any()


def test_phases_do_not_depend_on_the_way_the_cube_looks(cube: ObjectModel) -> None:
    """The world turned about the vertical, and the cube about itself: the same phases."""
    truth = bounce(cube, np.random.default_rng(3), tosses=1, frames=80)[0]
    turn = quat_exp(np.array([0.0, 0.0, 0.7]))
    c, s = np.cos(0.7), np.sin(0.7)
    Z = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    q, v = truth.q.copy(), truth.v.copy()
    q[:, :3], v[:, :3] = q[:, :3] @ Z.T, v[:, :3] @ Z.T
    q[:, 3:7] = quat_mul(turn, q[:, 3:7])
    np.testing.assert_array_equal(label_phases(cube, truth.t, truth.q, truth.v), label_phases(cube, truth.t, q, v))


def test_what_is_no_motion_is_refused(cube: ObjectModel) -> None:
    t, q, v = still(5, 1.0)
    q[2, 0] = np.nan
    with pytest.raises(MotionError, match="finite"):
        label_phases(cube, t, q, v)


def test_real_tosses_fly_hit_slide_and_rest(cube: ObjectModel, shared_data: Path) -> None:
    tracks = read_contactnets(shared_data / "contactnets_cube")[::25]
    for track in tracks:
        assert track.v is not None
        phase = label_phases(cube, track.t, track.q, track.v)
        assert phase[0] == Phase.FLIGHT
        assert phase[-1] == Phase.REST
        order = [int(np.argmax(phase == p)) for p in (Phase.FLIGHT, Phase.IMPACT, Phase.REST)]
        assert order == sorted(order)
        assert (phase == Phase.SLIDE).mean() > 0.2
