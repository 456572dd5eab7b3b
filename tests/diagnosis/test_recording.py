"""Tosses that are recorded wrongly, in one plane, or before their release: what is corrected, hidden or left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen, with_effect
from tests.models.made import DT, thrown, toss_of
from tossid.diagnosis.correction import CORRECTABLE, corrected
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.diagnosis.localisation.noise import noise_floor, still_channels
from tossid.diagnosis.plane import in_plane, plane_normal
from tossid.diagnosis.release import bound_frames
from tossid.motion import label_phases
from tossid.objects import ObjectModel
from tossid.physics.effects import World, effect_named
from tossid.rotations import geodesic_angle
from tossid.types import Toss

VALUES = {
    "world_tilt": [0.03, -0.02],
    "ground_height": [0.004],
    "length_scale": [1.02],
    "body_frame_offset": [0.003, -0.002, 0.004],
    "joint_offset": [0.1],
}


def as_recorded(world: World) -> list[Toss]:
    """Three throws, the same in every world, as each records them."""
    model = world.object
    q, v = thrown(np.random.default_rng(0), 3, model.n_joints)
    frames = 12
    start = world.recorded(q, v)
    run = world.roll_out(*start, n_steps=frames, dt=DT, substeps=4)
    speeds, cov = np.tile(start[1][:, None], (1, frames + 1, 1)), np.diag(np.arange(1.0, model.nv + 1)) * 1e-8
    made = (toss_of(str(i), run[i], speeds[i], cov=cov) for i in range(3))
    return [replace(toss, q_measured=toss.q, q_measured_cov=toss.q_cov) for toss in made]


@pytest.mark.parametrize("name", CORRECTABLE)
def test_a_corrected_toss_is_that_of_a_right_recording(name: str, cube: ObjectModel, elbow: ObjectModel) -> None:
    world, effect = World(elbow if name == "joint_offset" else cube), effect_named(name)
    values = np.array(VALUES[name])
    wrong, right = as_recorded(effect.at(world, values)), as_recorded(world)
    assert np.abs(wrong[0].q - right[0].q).max() > 1e-3
    for now, truth in zip((corrected(toss, effect.at(world, values), world) for toss in wrong), right, strict=True):
        np.testing.assert_allclose(now.q[:, :3], truth.q[:, :3], atol=1e-9)
        assert geodesic_angle(now.q[:, 3:7], truth.q[:, 3:7]).max() < 1e-7
        np.testing.assert_allclose(now.q[:, 7:], truth.q[:, 7:], atol=1e-9)
        np.testing.assert_allclose(now.v[0], truth.v[0], atol=1e-9)
        np.testing.assert_allclose(now.measured[0], now.q, atol=1e-12)


def test_covariances_turn_and_scale_with_the_positions(cube: ObjectModel) -> None:
    toss = as_recorded(World(cube))[0]
    scaled = corrected(toss, with_effect(cube, "length_scale", [1.25]), World(cube))
    np.testing.assert_allclose(scaled.q_cov[:, :3, :3], toss.q_cov[:, :3, :3] / 1.25**2, rtol=1e-12)
    np.testing.assert_allclose(scaled.q_cov[:, 3:, 3:], toss.q_cov[:, 3:, 3:], rtol=1e-12)
    turned = corrected(toss, with_effect(cube, "world_tilt", [0.2, 0.0]), World(cube))
    np.testing.assert_allclose(np.linalg.eigvalsh(turned.q_cov[0]), np.linalg.eigvalsh(toss.q_cov[0]), rtol=1e-9)
    assert turned.q_cov[0, 1, 2] != 0


# ---------------------------------------------------------------- motions in a plane


def planar(cube: ObjectModel, axis: int, count: int = 8) -> list[Toss]:
    """Drops that spin about the world's x (0) or y (1) and move across it."""
    rng = np.random.default_rng(axis)
    other = 1 - axis
    q, v = np.zeros((count, 7)), np.zeros((count, 6))
    angle = rng.uniform(-np.pi, np.pi, count)
    q[:, 2], q[:, 3], q[:, 4 + axis] = rng.uniform(0.2, 0.3, count), np.cos(angle / 2), np.sin(angle / 2)
    v[:, other], v[:, 3 + axis] = rng.uniform(-1, 1, count), rng.uniform(-8, 8, count)
    run = World(cube).roll_out(q, v, n_steps=70, dt=DT, substeps=8, impact_parts=4)
    t, out = np.arange(71) * DT, []
    for k in range(count):
        poses = run[k].copy()
        poses[:, axis] = 0.0
        turn = np.unwrap(2 * np.arctan2(poses[:, 4 + axis], poses[:, 3])) + rng.normal(0, 1e-3, 71)
        poses[:, 3:] = 0.0
        poses[:, 3], poses[:, 4 + axis] = np.cos(turn / 2), np.sin(turn / 2)
        poses[:, [other, 2]] += rng.normal(0, 1e-4, (71, 2))
        speed = np.zeros((71, 6))
        speed[:, :3], speed[:, 3 + axis] = np.gradient(poses[:, :3], DT, axis=0), np.gradient(turn, DT)
        cov, phase = np.diag([1e-8] * 3 + [1e-6] * 3), label_phases(cube, t, poses, speed)
        out.append(toss_of(str(k), poses, speed, cov=cov, phase=phase))
    return out


def test_the_normal_of_a_plane_is_found_and_tosses_have_none(cube: ObjectModel) -> None:
    for axis in (0, 1):
        np.testing.assert_allclose(plane_normal(planar(cube, axis)), np.eye(3)[axis], atol=1e-6)
    tosses, some = seen(World(cube), cube, 4, seed=1), (EFFECTS["wind"], EFFECTS["friction"])
    assert plane_normal(tosses) is None
    assert in_plane(tosses, World(cube), some) == (some, None)


def test_channels_out_of_the_plane_have_no_floor(cube: ObjectModel) -> None:
    tosses = planar(cube, 1)
    windows = make_windows(tosses, cube)
    assert list(still_channels(windows)) == [False, True, False, True, False, True]
    floor = noise_floor(windows)
    assert (floor.deviance[..., [1, 3, 5]] == 0).all()
    assert floor.rms == pytest.approx(np.sqrt(0.5), rel=0.2)
    moved = [replace(toss, q=toss.q + np.array([0, 1e-4, 0, 0, 0, 0, 0]) * (k % 2)) for k, toss in enumerate(tosses)]
    assert not still_channels(make_windows(moved, cube))[1]


def test_a_plane_hides_what_points_out_of_it(cube: ObjectModel) -> None:
    names = ("com_offset", "ground_tilt", "uniform_force", "wind", "vortex", "torsional_friction", "friction")
    some = [EFFECTS[name] for name in (*names, "anisotropic_friction")]
    library, plane = in_plane(planar(cube, 1), World(cube), some)
    assert {effect.name: [p.name for p in effect.parameters] for effect in library} == {
        "com_offset": ["x_m", "z_m"],
        "ground_tilt": ["y_rad"],
        "uniform_force": ["x_n", "z_n"],
        "wind": ["x_ms", "c_nspm"],
        "friction": ["mu"],
    }
    # friction by direction is friction in a plane
    assert set(plane.effects) == {"vortex", "torsional_friction", "anisotropic_friction"}
    assert ("com_offset", "y_m") in plane.hidden
    # parameters that stay leave the world alone
    world = library[0].at(World(cube), np.array([1e-3, 2e-3]))
    whole = EFFECTS["com_offset"].at(World(cube), np.array([1e-3, 0.0, 2e-3]))
    np.testing.assert_array_equal(world.object.com, whole.object.com)


# ---------------------------------------------------------------- frames before the release


def held_for(tosses: list[Toss], frames: int, acceleration: float) -> list[Toss]:
    """Tosses whose first frames fall faster by an acceleration, from a first height that is higher for it."""
    out = []
    for toss in tosses:
        left = np.maximum(toss.t[frames] - toss.t, 0.0)
        q = toss.q.copy()
        q[:, 2] -= 0.5 * acceleration * left**2
        out.append(replace(toss, q=q))
    return out


def test_frames_that_are_held_are_counted_and_drag_and_few_tosses_show_none(cube: ObjectModel) -> None:
    tosses = seen(World(cube), cube, 40, seed=1, frames=60)
    for frames in (0, 1, 3):
        assert bound_frames(held_for(tosses, frames, 25.0), cube) == frames
    assert bound_frames(held_for(tosses[:4], 3, 25.0), cube) == 0
    world = EFFECTS["quadratic_drag"].at(World(cube), np.array([0.1]))
    assert bound_frames(seen(world, cube, 40, seed=2, frames=60), cube) == 0
