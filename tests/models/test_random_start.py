"""A start that is drawn is within its ranges, and differs by the seed alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tossid.models import build_model, variant
from tossid.models.random_start import BALL, CORNER_OFFSET, FRICTION, draw_start
from tossid.objects import ObjectModel


def test_corners_are_off_by_a_normal_number_or_in_a_ball(cube: ObjectModel) -> None:
    rng = np.random.default_rng(0)
    drawn, scales = zip(*(draw_start(cube, rng) for _ in range(40)), strict=True)
    off = np.concatenate([start.corner_pos - cube.corner_pos for start in drawn])
    np.testing.assert_allclose(off.std(), CORNER_OFFSET * 0.5 * cube.width, rtol=0.1)
    assert all(FRICTION[0] <= start.friction <= FRICTION[1] for start in drawn)
    np.testing.assert_allclose(drawn[0].inertia, scales[0] * cube.inertia)
    ball, _ = draw_start(cube, rng, ball=True, inertia=False)
    assert np.linalg.norm(ball.corner_pos, axis=1).max() <= BALL
    np.testing.assert_array_equal(ball.inertia, cube.inertia)


def test_the_seed_draws_a_models_start(cube: ObjectModel) -> None:
    first, again, other = (build_model(variant("paper_cnrpi"), cube, seed=seed).learned_object() for seed in (0, 0, 1))
    np.testing.assert_array_equal(first.corner_pos, again.corner_pos)
    assert first.friction == again.friction != other.friction
    assert np.abs(first.inertia / cube.inertia.max()).max() != np.abs(other.inertia / cube.inertia.max()).max()
    given = build_model(replace(variant("paper_cn"), random_start=False), cube).learned_object()
    np.testing.assert_allclose(given.corner_pos, cube.corner_pos)
