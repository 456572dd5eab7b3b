"""A stated size that tosses at rest contradict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tossid.motion import MeasurementModel, estimate_measurement
from tossid.objects import ObjectModel
from tossid.training.stated_size import size_contradiction
from tossid.types import Toss


def resting(cube: ObjectModel, width: float, count: int) -> list[Toss]:
    """Cubes of a width that lie on a face, with 0.1 mm of noise."""
    rng = np.random.default_rng(0)
    zero, phase = np.zeros((5, 6, 6)), np.zeros(5, dtype=np.uint8)
    found = []
    for number in range(count):
        q = np.tile([0.0, 0.0, 0.5 * width + 1e-4 * rng.normal(), 1.0, 0.0, 0.0, 0.0], (5, 1))
        found.append(Toss(f"{number}", np.arange(5) / 148, q, np.zeros((5, 6)), zero, zero, phase))
    return found


@pytest.mark.parametrize("ratio", [0.95, 1.1])
def test_a_size_that_tosses_contradict_is_said_with_its_figure(cube: ObjectModel, ratio: float) -> None:
    estimate = estimate_measurement(resting(cube, ratio * cube.width, 12), cube)
    found = size_contradiction(estimate, MeasurementModel())
    assert found is not None
    assert found["shown_over_stated"] == pytest.approx(ratio, abs=2e-3)
    assert found["ci95"][0] < ratio < found["ci95"][1]
    assert f"{100 * abs(ratio - 1):.0f}." in found["warning"]
    assert ("larger" if ratio > 1 else "smaller") in found["warning"]
    assert "learned corners take it up" in found["warning"]
    scaled = size_contradiction(estimate, MeasurementModel(length_scale=ratio))
    assert scaled is not None
    assert f"divides recorded lengths by {ratio:.4f}" in scaled["warning"]


def test_a_right_size_and_a_size_that_few_tosses_show_say_nothing(cube: ObjectModel) -> None:
    exact = MeasurementModel()
    assert size_contradiction(estimate_measurement(resting(cube, 1.005 * cube.width, 12), cube), exact) is None
    few = estimate_measurement(resting(cube, 1.1 * cube.width, 4), cube)
    assert size_contradiction(few, exact) is None
    sure = estimate_measurement(resting(cube, 1.1 * cube.width, 12), cube)
    assert size_contradiction(replace(sure, length_scale_ci95=(0.9, 1.3)), exact) is None
