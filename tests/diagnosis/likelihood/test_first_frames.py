"""The first frames of windows, and that first states are followed from them into the right mode."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.first_frames import first_frames
from tossid.diagnosis.likelihood.whitening import linearised
from tossid.diagnosis.likelihood.windows import Windows, make_windows
from tossid.objects import ObjectModel
from tossid.physics.effects import World


def with_contact(cube: ObjectModel, count: int, seed: int) -> Windows:
    windows = make_windows(seen(World(cube), cube, count, seed=seed, frames=70), cube)
    return windows.rows(np.flatnonzero(~windows.steady))


def test_only_first_frames_are_left(cube: ObjectModel) -> None:
    windows = with_contact(cube, 6, 2)
    part = first_frames(windows, 0.4)
    before = windows.inside.sum(1)
    np.testing.assert_array_equal(part.inside.sum(1), np.ceil(0.4 * before))
    np.testing.assert_array_equal(part.steps, part.inside.sum(1))
    residuals = part.residuals(part.predicted(World(cube)))
    assert (residuals[~part.inside] == 0.0).all()
    whole = windows.residuals(windows.predicted(World(cube)))
    np.testing.assert_allclose(residuals[part.inside], whole[part.inside], atol=1e-12)


def test_a_restart_follows_first_states_from_first_frames(cube: ObjectModel) -> None:
    """Recorded velocities are far off; over all frames at once, most fits end in other impacts than those seen."""
    world, noise = World(cube), np.random.default_rng(0)
    count, poor = 0, np.zeros(2, dtype=int)
    for seed in (3, 4, 5):
        windows = with_contact(cube, 12, seed)
        off = noise.normal(size=windows.v.shape) * np.array([0.15] * 3 + [2.0] * 3)
        lost = replace(windows, v=windows.v + off, at_v=windows.v + off)
        count += len(windows.q)
        for restarts in (0, 1):
            kept, whitening, residuals = linearised(lost, world, refine=6, restarts=restarts)
            n = 6 * kept.inside.sum(1)
            poor[restarts] += ((whitening(residuals) ** 2).sum((1, 2)) > n + 3 * np.sqrt(2 * n)).sum()
    at_once, followed = poor
    assert at_once > 0.07 * count
    assert followed < 0.4 * at_once
