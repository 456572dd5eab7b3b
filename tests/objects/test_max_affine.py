"""Vertices fitted to the frames in which they are lowest."""

from __future__ import annotations

import numpy as np
import pytest

from tests.objects.test_convex_shape import OFFSET, WEDGE, apart, rolled
from tossid.objects.half_spaces import half_spaces
from tossid.objects.max_affine import fit_vertices, loss_of, weights_of
from tossid.settings.objects import ShapeSettings

SETTINGS = ShapeSettings()


def test_vertices_go_where_the_frames_need_them() -> None:
    spaces = half_spaces(rolled(WEDGE + OFFSET, np.random.default_rng(0)))
    start = WEDGE + OFFSET + 2e-3 * np.random.default_rng(1).normal(size=WEDGE.shape)
    fit = fit_vertices(spaces, start, np.zeros(3), SETTINGS, gap=4e-3, level=True)
    assert apart(fit.vertices, WEDGE + OFFSET) < 1e-3
    assert fit.ground.tolist() == [0.0, 0.0, 0.0]


def test_weights_have_the_gradient_of_the_loss() -> None:
    gap = np.array([-2e-3, -1e-4, 2e-4, 3e-3])
    free, step = np.zeros(4, dtype=bool), 1e-8
    ahead, behind = (loss_of(gap + sign * step, free, 1e-3, SETTINGS) for sign in (1, -1))
    slope = 2 * gap * weights_of(gap, free, 1e-3, SETTINGS) / SETTINGS.noise**2
    assert (ahead - behind) / (2 * step) == pytest.approx(slope, rel=1e-5)


def test_a_frame_in_flight_only_bounds() -> None:
    free = np.ones(2, dtype=bool)
    assert weights_of(np.array([1e-3, -1e-4]), free, 1e-3, SETTINGS).tolist() == [0.0, 1.0]
