"""MuJoCo as an engine: exact flight, rigid contact without bounce, friction's known distances."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tossid.errors import DivergedError, InputError, MotionError
from tossid.objects import OBJECT_FILES, ObjectModel, corner_positions, load_object
from tossid.physics.effects import World
from tossid.physics.effects.in_mujoco import toss_in_mujoco

DT = 1 / 148
HALF = 0.0524


@pytest.fixture(scope="module")
def cube() -> ObjectModel:
    return load_object(OBJECT_FILES / "cube.xml", friction=0.18)


def tosses(model: ObjectModel, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    q, v = np.zeros((count, model.nq)), np.zeros((count, model.nv))
    q[:, 3:7] = rng.normal(size=(count, 4))
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    q[:, 7:] = rng.uniform(-1.5, 1.5, size=(count, model.n_joints))
    q[:, 2] = rng.uniform(0.1, 0.3, count) - corner_positions(model, q)[..., 2].min(axis=1)
    v[:, :3], v[:, 3:6] = rng.normal(size=(count, 3)) * [0.7, 0.7, 0.5], rng.normal(size=(count, 3)) * 5
    return q, v


def test_free_flight_is_a_parabola_in_our_order_of_state(cube: ObjectModel) -> None:
    q0, v0 = tosses(cube, 3, 0)
    q0[:, 2] += 10
    q, v = toss_in_mujoco(World(cube, gravity=9.5), q0, v0, 40, DT)
    t = DT * np.arange(41)[:, None]
    np.testing.assert_allclose(q[..., :2], q0[:, None, :2] + t * v0[:, None, :2], atol=1e-9)
    np.testing.assert_allclose(v[..., 2], v0[:, None, 2] - 9.5 * t[:, 0], atol=1e-9)
    # A cube spins steadily: body rates stay, the angle turned is rate times time.
    np.testing.assert_allclose(v[..., 3:], np.broadcast_to(v0[:, None, 3:], v[..., 3:].shape), atol=1e-9)
    turned = 2 * np.arccos(np.clip(np.abs((q[:, 10, 3:] * q0[:, 3:]).sum(axis=1)), 0, 1))
    rate = np.linalg.norm(v0[:, 3:], axis=1)
    np.testing.assert_allclose(turned, np.abs((rate * t[10] + np.pi) % (2 * np.pi) - np.pi), atol=1e-7)


def test_landing_neither_sinks_in_nor_bounces(cube: ObjectModel) -> None:
    q0, v0 = tosses(cube, 6, 1)
    q, v = toss_in_mujoco(World(cube), q0, v0, 222, DT)
    lowest = corner_positions(cube, q)[..., 2].min(axis=-1)
    assert lowest.min() > -1e-4
    energy = (
        0.5 * 0.37 * (v[..., :3] ** 2).sum(-1) + 0.5 * 0.00081 * (v[..., 3:] ** 2).sum(-1) + 0.37 * 9.81 * q[..., 2]
    )
    assert np.diff(energy, axis=1).max() < 1e-4 * energy[:, 0].max()
    np.testing.assert_allclose(q[:, -1, 2], HALF, atol=1e-6)
    assert np.abs(v[:, -1]).max() < 1e-6


def test_a_flat_landing_does_not_bounce(cube: ObjectModel) -> None:
    """From heights that meet the ground at every phase of a time step."""
    q0 = np.tile([0, 0, 0, 1, 0, 0, 0.0], (10, 1))
    q0[:, 2] = HALF + 0.2 + np.linspace(0, 1e-3, 10)
    _, v = toss_in_mujoco(World(cube), q0, np.zeros((10, 6)), 60, DT)
    assert (v[..., 2].min(axis=1) < -1.9).all()
    assert v[..., 2].max() < 0.01


def test_a_sliding_cube_stops_where_coulomb_says(cube: ObjectModel) -> None:
    """Distance v² / (2 mu g), over hops of at most (mu v)² / (2 g): MuJoCo's relaxed friction lifts what slips."""
    q0 = np.array([0, 0, HALF, 1, 0, 0, 0.0])
    speed = np.array([0.5, 1.0])
    v0 = np.zeros((2, 6))
    v0[:, 0] = speed
    q, v = toss_in_mujoco(World(cube), np.tile(q0, (2, 1)), v0, 110, DT)
    np.testing.assert_allclose(q[:, -1, 0], speed**2 / (2 * 0.18 * 9.81), rtol=0.005)
    assert np.abs(v[:, -1]).max() < 1e-6
    np.testing.assert_allclose(q[:, -1, 1], 0, atol=1e-3)
    assert (q[..., 2].max(axis=1) - HALF <= 1.2 * (0.18 * speed) ** 2 / (2 * 9.81)).all()


def test_the_elbow_lands_and_threads_and_chunks_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    elbow = load_object(OBJECT_FILES / "elbow.xml", friction=0.3)
    q0, v0 = tosses(elbow, 4, 2)
    q, v = toss_in_mujoco(World(elbow), q0, v0, 60, DT, substeps=40)
    assert q.shape == (4, 61, 8)
    assert v.shape == (4, 61, 7)
    np.testing.assert_allclose(np.linalg.norm(q[..., 3:7], axis=-1), 1, atol=1e-12)
    monkeypatch.setattr("tossid.physics.mujoco_engine._ROWS_AT_ONCE", 1)
    again = toss_in_mujoco(World(elbow), q0, v0, 60, DT, substeps=40, n_threads=2)
    np.testing.assert_array_equal(again[0], q)
    np.testing.assert_array_equal(again[1], v)


def test_what_diverges_or_is_no_start_is_told(
    cube: ObjectModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    q0, v0 = tosses(cube, 2, 3)
    fast = v0.copy()
    fast[1, 3:] = 1e11
    with pytest.raises(DivergedError, match="toss 1") as error:
        toss_in_mujoco(World(cube), q0, fast, 10, DT)
    np.testing.assert_array_equal(np.asarray(error.value.state)[7:], fast[1])
    with pytest.raises(DivergedError, match="toss 1"):
        toss_in_mujoco(World(cube), q0, fast, 10, DT, n_threads=2)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(MotionError, match="row 0"):
        toss_in_mujoco(World(cube), q0 * np.nan, v0, 10, DT)
    with pytest.raises(MotionError, match="shapes"):
        toss_in_mujoco(World(cube), q0[:, :6], v0, 10, DT)
    with pytest.raises(InputError, match="positive"):
        toss_in_mujoco(World(cube), q0, v0, 10, DT, substeps=0)
