"""Scatter of resting poses: found where it is, none of noise, none of what all tosses share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.tossed import seen
from tossid.motion.resting import rest_scatter
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.rotations import quat_exp, quat_mul, quat_rotate
from tossid.settings.motion import RestScatterSettings
from tossid.types import Toss

SETTINGS = RestScatterSettings()


@pytest.fixture(scope="module")
def tosses(cube: ObjectModel) -> list[Toss]:
    return seen(World(cube, ground_height=2e-3, ground_tilt=(0.01, 0.0)), cube, 24, seed=11, frames=150)


def shifted(toss: Toss, up: float, turn: np.ndarray) -> Toss:
    q = toss.q.copy()
    q[:, 2] += up
    q[:, 3:7] = quat_mul(q[:, 3:7], quat_exp(turn))
    return replace(toss, q=q, q_measured=None, q_measured_cov=None)


def test_noise_and_common_offsets_do_not_count_as_scatter(cube: ObjectModel, tosses: list[Toss]) -> None:
    assert rest_scatter(tosses, cube) == (0.0, 0.0)


def test_a_frame_that_is_off_is_no_scatter(cube: ObjectModel, tosses: list[Toss]) -> None:
    """It puts every side that is down at a height of its own."""
    off = np.array([1.3e-3, 5e-4, -9e-4])
    moved = []
    for toss in tosses:
        q = toss.q.copy()
        q[:, :3] += quat_rotate(q[:, 3:7], off)
        moved.append(replace(toss, q=q, q_measured=None, q_measured_cov=None))
    assert rest_scatter(moved, cube)[0] == 0.0
    assert rest_scatter(moved[: 2 * SETTINGS.fewest_tosses - 1], cube)[0] > 2e-4


def test_scatter_comes_back(cube: ObjectModel, tosses: list[Toss]) -> None:
    rng = np.random.default_rng(0)
    moved = [shifted(toss, 5e-4 * rng.normal(), 8e-3 * rng.normal(size=3)) for toss in tosses]
    height, tilt = rest_scatter(moved, cube)
    assert height == pytest.approx(5e-4, rel=0.6)
    assert tilt == pytest.approx(8e-3, rel=0.6)


def test_over_the_order_scatter_comes_back_and_steps_and_drifts_do_not_count(
    cube: ObjectModel, tosses: list[Toss]
) -> None:
    rng = np.random.default_rng(0)
    moved = [shifted(toss, 5e-4 * rng.normal(), 8e-3 * rng.normal(size=3)) for toss in tosses]
    height, tilt = rest_scatter(moved, cube, over_order=True)
    assert height == pytest.approx(5e-4, rel=0.6)
    assert tilt == pytest.approx(8e-3, rel=0.6)
    for rise in ([3e-3 * (i >= 14) for i in range(24)], [1e-4 * i for i in range(24)]):
        changing = [shifted(toss, up, np.zeros(3)) for toss, up in zip(tosses, rise, strict=True)]
        assert rest_scatter(changing, cube)[0] > 3e-4
        assert rest_scatter(changing, cube, over_order=True)[0] < 1.2e-4


def test_few_resting_tosses_tell_nothing(cube: ObjectModel, tosses: list[Toss]) -> None:
    rng = np.random.default_rng(1)
    moved = [shifted(toss, 5e-3 * rng.normal(), np.zeros(3)) for toss in tosses]
    assert rest_scatter(moved[: SETTINGS.fewest_tosses - 1], cube) == (0.0, 0.0)
    short = [
        replace(
            toss, **{k: getattr(toss, k)[: SETTINGS.frames - 1] for k in ("t", "q", "v", "q_cov", "v_cov", "phase")}
        )
        for toss in tosses
    ]
    assert rest_scatter(short, cube) == (0.0, 0.0)
