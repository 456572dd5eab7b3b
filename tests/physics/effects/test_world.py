"""A world's frames: recorded, true, and the ground's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tests.physics.worlds import DT, STRANGE_RECORDING, states
from tossid.objects import OBJECT_FILES, ObjectModel, load_object
from tossid.physics import simulate
from tossid.physics.effects import Forces, RecordingErrors, World
from tossid.rotations import quat_boxminus

Array = NDArray[np.float64]


STRANGE = World(
    load_object(OBJECT_FILES / "cube.xml"), ground_height=0.03, ground_tilt=(0.05, -0.08), recording=STRANGE_RECORDING
)


def test_states_come_back_from_the_ground_s_frame() -> None:
    q, v = states(50)
    back_q, back_v = STRANGE.recorded(*STRANGE.to_ground(q, v))
    np.testing.assert_allclose(back_q, q, atol=1e-12)
    np.testing.assert_allclose(back_v, v, atol=1e-12)


def test_recorded_velocities_are_the_rates_of_recorded_poses() -> None:
    """Of tosses in the ground's frame, at small steps."""
    q0, v0 = STRANGE.to_ground(*states(10))
    dt = 1e-5
    done = simulate(STRANGE.system(), q0, v0, n_steps=2, dt=dt)
    q, v = STRANGE.recorded(done.q, done.v)
    between = 2 * dt * STRANGE.recording.clock_rate
    np.testing.assert_allclose((q[:, 2, :3] - q[:, 0, :3]) / between, v[:, 1, :3], atol=1e-5)
    np.testing.assert_allclose(quat_boxminus(q[:, 2, 3:], q[:, 0, 3:]) / between, v[:, 1, 3:], atol=1e-5)


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
