"""Recorded motion is the true motion, transformed: lengths, clocks, frames, tilts, joints and late rotations."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.physics.trees import flying
from tests.physics.worlds import DT, STRANGE_RECORDING, states
from tossid.objects import ObjectModel
from tossid.physics import simulate
from tossid.physics.effects import Forces, RecordingErrors, World, effect_named
from tossid.rotations import geodesic_angle, matrix_to_quat, quat_boxminus, quat_exp, quat_mul, quat_to_matrix

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


def test_forces_stay_in_the_true_world_whatever_the_ground(cube: ObjectModel) -> None:
    """In flight the ground is nothing."""
    forces = Forces(x=0.5, y=-0.3, z=0.7, spring=6.0, center_x=0.2, center_y=-0.3, center_z=0.8, quadratic=0.1)
    q, v = np.array([[0.0, 0, 3, 1, 0, 0, 0]]), np.array([[1.0, 0.5, 1, 3, 0, -2]])
    ends = [
        World(cube, forces=forces, ground_tilt=tilt, ground_height=height).roll_out(
            q, v, n_steps=30, dt=DT, substeps=20
        )
        for tilt, height in (((0.0, 0.0), 0.0), ((0.1, -0.15), 0.04))
    ]
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)


def test_worlds_that_differ_in_contact_alone_fly_alike(cube: ObjectModel) -> None:
    world = World(cube)
    bouncy = cube.with_changes(restitution=0.5, friction=2 * cube.friction)
    alike = [World(bouncy), World(cube, ground_height=0.02), World(cube.with_changes(inertia=1.3 * cube.inertia))]
    for other in alike:
        assert world.flies_like(other)
        assert other.flies_like(world)
    different = [
        World(cube, gravity=9.0),
        World(cube, forces=Forces(linear=0.01)),
        World(cube, ground_tilt=(0.01, 0.0)),
        World(cube.with_changes(com=cube.com + 1e-3)),
        World(cube.with_changes(inertia=cube.inertia + 1e-4 * np.diag([1.0, 0.0, 0.0]))),
    ]
    for other in different:
        assert not world.flies_like(other)
        assert not other.flies_like(world)
    # the air turns a body the slower, the larger its inertia
    drag = Forces(spin=1e-5)
    assert not World(cube, forces=drag).flies_like(World(cube.with_changes(inertia=1.3 * cube.inertia), forces=drag))


def test_how_far_below_the_stated_object_corners_may_be(cube: ObjectModel) -> None:
    arm = float(np.linalg.norm(cube.corner_pos, axis=1).max())
    high, far, spin = np.array([0.5, 0.1]), np.array([0.3, 0.0]), np.array([10.0, 0.0])

    def below(world: World) -> np.ndarray:
        return world.lower_corners(cube, high, far, spin)

    np.testing.assert_allclose(below(World(cube)), 0.0)
    np.testing.assert_allclose(below(World(cube.resized(1.1))), 0.1 * arm)
    np.testing.assert_allclose(below(World(cube, ground_tilt=(0.01, 0.0))), [0.003, 0.0])
    offset = World(cube, recording=RecordingErrors(frame_offset=(0.0, 0.02, 0.0)))
    np.testing.assert_allclose(below(offset), 0.02)
    np.testing.assert_allclose(below(World(cube, recording=RecordingErrors(length_scale=1.25))), 0.2 * high)
    delayed = World(cube, recording=RecordingErrors(rotation_delay=-0.003))
    np.testing.assert_allclose(below(delayed), [0.03 * arm, 0.0])


@pytest.mark.parametrize("name", ["strange", "joint", "delay"])
def test_recorded_states_lead_back_to_the_true_ones(cube: ObjectModel, elbow: ObjectModel, name: str) -> None:
    strange = {"ground_height": 0.03, "ground_tilt": (0.05, -0.08), "recording": STRANGE_RECORDING}
    world, (q, v) = {
        "strange": (World(cube, **strange), states(50)),
        "joint": (World(elbow, recording=RecordingErrors(1.1, 0.9, joint_offset=0.3)), flying(elbow)),
        "delay": (World(cube, recording=RecordingErrors(rotation_delay=0.004)), states(5)),
    }[name]
    seen_q, seen_v = world.recorded(q, v)
    back_q, back_v = world.to_ground(seen_q, seen_v)
    if name == "strange":  # the ground's frame is the third one
        again = world.recorded(back_q, back_v)
        np.testing.assert_allclose(again[0], seen_q, atol=1e-12)
        return
    np.testing.assert_allclose(back_v, v, atol=1e-12)
    np.testing.assert_allclose(np.delete(back_q - q, [3, 4, 5, 6], axis=1), 0.0, atol=1e-12)
    assert geodesic_angle(back_q[:, 3:7], q[:, 3:7]) == pytest.approx(0.0, abs=1e-7)
    if name == "delay":
        late = geodesic_angle(seen_q[:, 3:7], q[:, 3:7])
        assert late == pytest.approx(0.004 * np.linalg.norm(v[:, 3:], axis=1))


# ---------------------------------------------------------------- late rotations


FINE = 16
"""Parts of a frame by which the truth is simulated."""


@pytest.mark.parametrize("parts", [-40, -5, 3, 21])
def test_rotations_are_those_of_an_earlier_time(cube: ObjectModel, parts: int) -> None:
    delay = parts * DT / FINE
    q, v = states(6)
    q[:, 2] -= 0.25  # they land
    fine = simulate(World(cube).system(), q, v, n_steps=60 * FINE, dt=DT / FINE, impact_parts=8)
    world = effect_named("rotation_delay").at(World(cube), np.array([delay]))
    run = world.roll_out(*world.recorded(q, v), n_steps=40, dt=DT, substeps=FINE, impact_parts=8)
    first = max(0, -(-parts // FINE))
    frames = np.arange(first, 30)
    np.testing.assert_allclose(run[:, frames, :3], fine.q[:, frames * FINE, :3], atol=2e-3)
    off = geodesic_angle(run[:, frames, 3:7], fine.q[:, frames * FINE - parts, 3:7])
    plain = geodesic_angle(fine.q[:, frames * FINE, 3:7], fine.q[:, frames * FINE - parts, 3:7])
    assert np.median(off) < 1e-4
    assert np.percentile(off, 95) < 0.1 * np.percentile(plain, 95)
