"""Residuals are measured minus predicted, averaged over the frames of a row."""

from __future__ import annotations

import numpy as np

from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.residuals import LARGEST, mean_residuals
from tossid.diagnosis.likelihood.states import difference
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.objects import ObjectModel
from tossid.physics.effects import World


def test_residuals_are_means_of_differences_over_the_frames_of_a_row(cube: ObjectModel) -> None:
    windows = make_windows(seen(World(cube), cube, 6, seed=1, frames=200))
    run = windows.predicted(World(cube, gravity=9.0))
    run[3] = np.nan
    off = difference(windows.y[:, : run.shape[1]], run)
    expected = windows.mix[..., : run.shape[1]] @ np.clip(np.where(np.isfinite(off), off, LARGEST), -LARGEST, LARGEST)
    twice = windows.residuals(np.concatenate([run, run]))
    np.testing.assert_allclose(twice[: len(run)], expected, atol=1e-14)
    np.testing.assert_array_equal(twice[: len(run)], twice[len(run) :])


def test_frames_after_a_windows_last_do_not_count() -> None:
    y = np.zeros((1, 3, 8))
    y[..., 3] = 1.0
    predicted = y.copy()
    predicted[0, :, 0] = [-0.2, -0.4, 5.0]
    mix = np.array([[[0.5, 0.5, 0.0], [0.0, 0.0, 0.0]]])
    found = mean_residuals(y, predicted, mix, np.array([2]), np.array([0]))
    np.testing.assert_allclose(found[0, 0], [0.3, 0, 0, 0, 0, 0, 0], atol=1e-15)
    assert not found[0, 1].any()
