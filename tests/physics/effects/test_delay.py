"""Late rotations: each frame has the rotation that the true motion had so much earlier, impacts included."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.physics.worlds import DT, states
from tossid.objects import ObjectModel
from tossid.physics import simulate
from tossid.physics.effects import World, effect_named
from tossid.rotations import geodesic_angle

Array = NDArray[np.float64]
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


def test_a_recorded_state_leads_back_to_the_true_one(cube: ObjectModel) -> None:
    q, v = states(5)
    world = effect_named("rotation_delay").at(World(cube), np.array([0.004]))
    seen_q, seen_v = world.recorded(q, v)
    assert geodesic_angle(seen_q[:, 3:7], q[:, 3:7]) == pytest.approx(0.004 * np.linalg.norm(v[:, 3:], axis=1))
    back_q, back_v = world.to_ground(seen_q, seen_v)
    np.testing.assert_allclose(back_v, v, atol=1e-12)
    np.testing.assert_allclose(back_q[:, :3], q[:, :3], atol=1e-12)
    assert geodesic_angle(back_q[:, 3:7], q[:, 3:7]) == pytest.approx(0.0, abs=1e-7)


def test_steady_spin_does_not_show_it(cube: ObjectModel) -> None:
    """A cube's moments are equal, so its spin is steady: recorded flight is the same with and without a delay."""
    q, v = states(4)
    q[:, 2] += 5.0
    late = effect_named("rotation_delay").at(World(cube), np.array([-0.0023]))
    one, other = (world.roll_out(q, v, n_steps=20, dt=DT, substeps=2) for world in (World(cube), late))
    np.testing.assert_allclose(other[..., :3], one[..., :3], atol=1e-12)
    assert geodesic_angle(one[..., 3:7], other[..., 3:7]) == pytest.approx(0.0, abs=1e-6)
