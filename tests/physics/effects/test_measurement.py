"""Effects of the measurement: recorded motion is the true motion, transformed."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.physics.worlds import DT, STRANGE_RECORDING, states
from tossid.objects import ObjectModel
from tossid.physics import simulate
from tossid.physics.effects import RecordingErrors, World
from tossid.rotations import matrix_to_quat, quat_boxminus, quat_exp, quat_mul, quat_to_matrix

Array = NDArray[np.float64]


def by_hand(world: World, q: Array) -> Array:
    """Recorded poses of true ones, with matrices: p_rec = s W (p + R offset)."""
    r = world.recording
    W = quat_to_matrix(quat_exp(np.array([*r.world_tilt, 0.0])))
    R = quat_to_matrix(q[..., 3:])
    place = r.length_scale * (W @ (q[..., :3, None] + R @ np.array(r.frame_offset)[:, None]))[..., 0]
    return np.concatenate([place, matrix_to_quat(W @ R)], axis=-1)


@pytest.mark.parametrize(
    "recording",
    [
        RecordingErrors(length_scale=1.07),
        RecordingErrors(clock_rate=0.93),
        RecordingErrors(frame_offset=(0.01, -0.02, 0.015)),
        RecordingErrors(world_tilt=(0.08, -0.05)),
        STRANGE_RECORDING,
    ],
)
def test_a_recording_is_the_true_motion_transformed(cube: ObjectModel, recording: RecordingErrors) -> None:
    q, v = states(8)
    world = World(cube, recording=recording)
    r = recording
    # true motion in true time, and its recording by hand
    true = simulate(World(cube).system(), q, v, n_steps=40, dt=DT / r.clock_rate, substeps=2)
    seen = by_hand(world, true.q)
    # the first recorded state: positions and turns as poses say, rates by differences of the recorded pose
    tiny = 1e-7
    ahead, behind = q.copy(), q.copy()
    for place, sign in ((ahead, 1), (behind, -1)):
        place[:, :3] += sign * tiny * v[:, :3]
        place[:, 3:] = quat_mul(q[:, 3:], quat_exp(sign * tiny * v[:, 3:]))
    rate = 0.5 / tiny / r.clock_rate
    first_v = np.concatenate(
        [
            (by_hand(world, ahead)[:, :3] - by_hand(world, behind)[:, :3]) * rate,
            quat_boxminus(by_hand(world, ahead)[:, 3:], by_hand(world, behind)[:, 3:]) * rate,
        ],
        axis=1,
    )
    exact_v = world.recorded(q, v)[1]
    np.testing.assert_allclose(first_v, exact_v, atol=1e-6)
    rolled = world.roll_out(seen[:, 0], exact_v, n_steps=40, dt=DT, substeps=2)
    np.testing.assert_allclose(rolled[..., :3], seen[..., :3], atol=1e-9)
    assert quat_boxminus(rolled[..., 3:], seen[..., 3:]) == pytest.approx(0, abs=1e-7)  # rounding grows in contact


def test_world_tilt_turns_true_coordinates_into_recorded_ones(cube: ObjectModel) -> None:
    """Turned by +a about x, the vertical leans to -y: a falling body drifts to +y in the recording."""
    world = World(cube, recording=RecordingErrors(world_tilt=(0.1, 0.0)))
    q = np.array([[0.0, 0, 5, 1, 0, 0, 0]])
    seen = world.roll_out(q, np.zeros((1, 6)), n_steps=30, dt=DT, substeps=1)[0, -1]
    way = 0.5 * 9.81 * (30 * DT) ** 2
    np.testing.assert_allclose(seen[:3] - q[0, :3], way * np.array([0, np.sin(0.1), -np.cos(0.1)]), atol=1e-9)
