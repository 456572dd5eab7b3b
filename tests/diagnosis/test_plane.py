"""Motions in a plane are recognised, and hide what their reflection turns around or does not touch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen
from tests.models.made import DT
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.diagnosis.localisation.noise import noise_floor, still_channels
from tossid.diagnosis.plane import in_plane, plane_normal
from tossid.motion import label_phases
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.types import Toss


def planar(cube: ObjectModel, axis: int, count: int = 8) -> list[Toss]:
    """Drops that spin about the world's x (0) or y (1) and move across it."""
    rng = np.random.default_rng(axis)
    other = 1 - axis
    q, v = np.zeros((count, 7)), np.zeros((count, 6))
    angle = rng.uniform(-np.pi, np.pi, count)
    q[:, 2], q[:, 3], q[:, 4 + axis] = rng.uniform(0.2, 0.3, count), np.cos(angle / 2), np.sin(angle / 2)
    v[:, other], v[:, 3 + axis] = rng.uniform(-1, 1, count), rng.uniform(-8, 8, count)
    run = World(cube).roll_out(q, v, n_steps=70, dt=DT, substeps=8, impact_parts=4)
    t = np.arange(71) * DT
    cov = np.tile(np.diag([1e-8] * 3 + [1e-6] * 3), (71, 1, 1))
    out = []
    for k in range(count):
        poses = run[k].copy()
        poses[:, axis] = 0.0
        turn = np.unwrap(2 * np.arctan2(poses[:, 4 + axis], poses[:, 3])) + rng.normal(0, 1e-3, 71)
        poses[:, 3:] = 0.0
        poses[:, 3], poses[:, 4 + axis] = np.cos(turn / 2), np.sin(turn / 2)
        poses[:, [other, 2]] += rng.normal(0, 1e-4, (71, 2))
        speed = np.zeros((71, 6))
        speed[:, :3], speed[:, 3 + axis] = np.gradient(poses[:, :3], DT, axis=0), np.gradient(turn, DT)
        phase = label_phases(cube, t, poses, speed)
        out.append(Toss(str(k), t, poses, speed, cov, cov, phase))
    return out


@pytest.mark.parametrize("axis", [0, 1])
def test_the_normal_of_the_plane_is_found(cube: ObjectModel, axis: int) -> None:
    normal = plane_normal(planar(cube, axis))
    assert normal is not None
    np.testing.assert_allclose(normal, np.eye(3)[axis], atol=1e-6)


def test_tosses_have_no_plane(cube: ObjectModel) -> None:
    tosses = seen(World(cube), cube, 4, seed=1)
    assert plane_normal(tosses) is None
    some = (EFFECTS["wind"], EFFECTS["friction"])
    assert in_plane(tosses, World(cube), some) == (some, None)


def test_a_plane_hides_what_points_out_of_it(cube: ObjectModel) -> None:
    names = ("com_offset", "ground_tilt", "uniform_force", "wind", "vortex", "torsional_friction", "friction")
    library, plane = in_plane(planar(cube, 1), World(cube), [EFFECTS[name] for name in names])
    assert plane is not None
    left = {effect.name: [p.name for p in effect.parameters] for effect in library}
    assert left["com_offset"] == ["x_m", "z_m"]
    assert left["ground_tilt"] == ["y_rad"]
    assert left["uniform_force"] == ["x_n", "z_n"]
    assert left["friction"] == ["mu"]
    assert set(left["wind"]) == {"x_ms", "c_nspm"}
    assert set(plane.effects) == {"vortex", "torsional_friction"}
    assert ("com_offset", "y_m") in plane.hidden


def test_friction_by_direction_is_friction_in_a_plane(cube: ObjectModel) -> None:
    some = [EFFECTS["friction"], EFFECTS["anisotropic_friction"]]
    library, plane = in_plane(planar(cube, 1), World(cube), some)
    assert [effect.name for effect in library] == ["friction"]
    assert plane is not None
    assert plane.effects == ("anisotropic_friction",)


def test_parameters_that_stay_leave_the_world_alone(cube: ObjectModel) -> None:
    library, _ = in_plane(planar(cube, 0), World(cube), [EFFECTS["com_offset"]])
    (effect,) = library
    assert [p.name for p in effect.parameters] == ["y_m", "z_m"]
    world = effect.at(World(cube), np.array([1e-3, 2e-3]))
    whole = EFFECTS["com_offset"].at(World(cube), np.array([0.0, 1e-3, 2e-3]))
    np.testing.assert_array_equal(world.object.com, whole.object.com)


def test_channels_out_of_the_plane_have_no_floor(cube: ObjectModel) -> None:
    tosses = planar(cube, 1)
    windows = make_windows(tosses, cube)
    assert list(still_channels(windows)) == [False, True, False, True, False, True]
    floor = noise_floor(windows)
    assert (floor.deviance[..., [1, 3, 5]] == 0).all()
    assert floor.rms == pytest.approx(np.sqrt(0.5), rel=0.2)
    moved = [replace(toss, q=toss.q + np.array([0, 1e-4, 0, 0, 0, 0, 0]) * (k % 2)) for k, toss in enumerate(tosses)]
    assert not still_channels(make_windows(moved, cube))[1]
