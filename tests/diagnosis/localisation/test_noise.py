"""The noise floor: 1 where noise is as stated, more where flight shows more, and the same whatever is simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.density import student_deviance
from tossid.diagnosis.likelihood.windows import Windows, make_windows
from tossid.diagnosis.localisation.noise import expected_deviance, measure_noise, noise_floor
from tossid.objects import ObjectModel
from tossid.physics.effects import Forces, World
from tossid.types import Toss


@pytest.fixture(scope="module")
def tosses(cube: ObjectModel) -> list[Toss]:
    return seen(World(cube, gravity=8.0, forces=Forces(quadratic=0.05)), cube, 24, seed=8)


@pytest.fixture(scope="module")
def windows(cube: ObjectModel, tosses: list[Toss]) -> Windows:
    return make_windows(tosses, cube)


def test_noise_as_stated_is_measured_whatever_forces_act(windows: Windows) -> None:
    found = measure_noise(windows)
    assert found.position == pytest.approx(1.0, abs=0.12)
    assert found.rotation == pytest.approx(1.0, abs=0.12)


def test_noise_beyond_the_stated_one_raises_the_floor(cube: ObjectModel, tosses: list[Toss]) -> None:
    boastful = [replace(toss, q_cov=toss.q_cov / 4.0) for toss in tosses]
    floor = noise_floor(make_windows(boastful, cube))
    assert floor.noise.position == pytest.approx(2.0, abs=0.25)
    assert floor.rms == pytest.approx(2.0, abs=0.25)
    modest = noise_floor(make_windows([replace(toss, q_cov=toss.q_cov * 4.0) for toss in tosses], cube))
    assert modest.noise.rotation == pytest.approx(0.5, abs=0.06)
    assert modest.rms == 1.0


def test_each_channel_has_its_expected_deviance(windows: Windows) -> None:
    floor = noise_floor(windows)
    assert floor.deviance.shape == (6,)
    assert floor.deviance[0] >= expected_deviance(1.0)


def test_no_flight_no_measurement(windows: Windows) -> None:
    grounded = windows.rows(np.flatnonzero(~windows.free))
    assert measure_noise(grounded).as_json() == {"position_over_stated": None, "rotation_over_stated": None}
    assert noise_floor(grounded).rms == 1.0


@pytest.mark.parametrize("std", [0.5, 1.0, 2.0])
def test_expected_deviance_is_the_mean_over_draws(std: float) -> None:
    drawn = student_deviance(std * np.random.default_rng(0).normal(size=400_000)).mean()
    assert expected_deviance(std) == pytest.approx(float(drawn), rel=0.01)
