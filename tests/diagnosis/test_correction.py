"""Tosses that are recorded wrongly are, when corrected, those that a right recording would have."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.tossed import with_effect
from tests.models.made import DT, thrown
from tossid.diagnosis.correction import (
    CORRECTABLE,
    corrected,
)
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
