"""Tosses that are recorded wrongly are, when corrected, those that a right recording would have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.tossed import seen, with_effect
from tests.models.made import DT, thrown
from tossid.diagnosis.correction import (
    CORRECTABLE,
    corrected,
    corrected_tosses,
    ending_at_origin,
    have_own_heights,
    last_corner,
    moved,
)
from tossid.motion.sessions.levelling import IDENTITY
from tossid.objects import ObjectModel, corner_positions
from tossid.physics.effects import World, effect_named
from tossid.rotations import geodesic_angle
from tossid.types import RecordingOrder, Toss

VALUES = {
    "world_tilt": [0.03, -0.02],
    "ground_height": [0.004],
    "length_scale": [1.02],
    "body_frame_offset": [0.003, -0.002, 0.004],
    "joint_offset": [0.1],
}
TILT = np.array([0.03, -0.02])


def as_recorded(world: World) -> list[Toss]:
    """Three throws, the same in every world, as each records them."""
    model = world.object
    q, v = thrown(np.random.default_rng(0), 3, model.n_joints)
    frames = 12
    start = world.recorded(q, v)
    run = world.roll_out(*start, n_steps=frames, dt=DT, substeps=4)
    cov = np.tile(np.diag(np.arange(1.0, model.nv + 1)) * 1e-8, (frames + 1, 1, 1))
    speeds = np.tile(start[1][:, None], (1, frames + 1, 1))
    t, phase = np.arange(frames + 1, dtype=np.float64) * DT, np.zeros(frames + 1, np.uint8)
    return [Toss(str(i), t, run[i], speeds[i], cov, cov, phase, "", run[i], cov) for i in range(3)]


@pytest.mark.parametrize("name", CORRECTABLE)
def test_a_corrected_toss_is_that_of_a_right_recording(name: str, cube: ObjectModel, elbow: ObjectModel) -> None:
    world, effect = World(elbow if name == "joint_offset" else cube), effect_named(name)
    values = np.array(VALUES[name])
    wrong, right = as_recorded(effect.at(world, values)), as_recorded(world)
    assert np.abs(wrong[0].q - right[0].q).max() > 1e-3
    for now, truth in zip(corrected_tosses(wrong, [effect.at(world, values)] * 3, world), right, strict=True):
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


def lowest(model: ObjectModel, toss: Toss) -> float:
    return float(corner_positions(model, toss.q[-1:])[..., 2].min())


@pytest.fixture(scope="module")
def shifted(cube: ObjectModel) -> tuple[Toss, ...]:
    """Tosses at rest in a tilted world, each shifted so that its last frame's lowest corner is at 0."""
    made = []
    for i, toss in enumerate(seen(with_effect(cube, "world_tilt", list(TILT)), cube, 12, seed=7, frames=150)):
        q = toss.q.copy()
        q[:, 2] -= lowest(cube, toss)
        made.append(replace(toss, q=q, name=str(i)))
    return tuple(made)


def test_heights_that_were_set_one_by_one_are_recognised(cube: ObjectModel, shifted: tuple[Toss, ...]) -> None:
    assert have_own_heights(shifted, cube, None)
    assert not have_own_heights(seen(World(cube), cube, 6, seed=1, frames=20), cube, None)
    # (ingest raised them, and says by how much)
    raised = tuple(replace(toss, q=toss.q + np.eye(7)[2] * 1e-3 * i) for i, toss in enumerate(shifted))
    n, names = len(raised), tuple(toss.name for toss in raised)
    places, none = np.zeros((n, 2)), np.zeros(n, dtype=np.int64)
    turns = np.tile(IDENTITY, (n, 1))
    order = RecordingOrder((), "names", names, (), np.zeros((n, 0)), places, turns, 1e-3 * np.arange(n), none)
    assert not have_own_heights(raised, cube, None)
    assert have_own_heights(raised, cube, order)


def test_a_tilt_turns_them_about_the_corner_whose_height_was_set(cube: ObjectModel, shifted: tuple[Toss, ...]) -> None:
    # as on a table half a metre wide
    far = [moved(toss, np.array([0.3 * np.cos(i), 0.3 * np.sin(i)])) for i, toss in enumerate(shifted)]
    tilted = [with_effect(cube, "world_tilt", list(TILT))] * len(far)
    right = corrected_tosses(far, tilted, World(cube), own_heights=True)
    about_origin = corrected_tosses(far, tilted, World(cube))
    assert max(abs(lowest(cube, toss)) for toss in right) < 5e-4
    assert max(abs(lowest(cube, toss)) for toss in about_origin) > 8e-3
    for toss, before in zip(right, far, strict=True):
        np.testing.assert_allclose(toss.q[-1, :2], before.q[-1, :2], atol=3e-3)


def test_tosses_are_moved_to_end_at_one_place(cube: ObjectModel, shifted: tuple[Toss, ...]) -> None:
    at_origin = ending_at_origin(shifted, cube)
    np.testing.assert_allclose([last_corner(toss, cube) for toss in at_origin], 0.0, atol=1e-12)
    np.testing.assert_array_equal([toss.q[:, 2:] for toss in at_origin], [toss.q[:, 2:] for toss in shifted])
