"""What `make links` measures."""

from __future__ import annotations

import pytest

from experiments.links import simulated
from experiments.tossed_shapes import ShapeTossSettings


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.* tosses have defects")
def test_an_elbow_is_learned_about_as_well_as_the_truth_predicts() -> None:
    (row,) = simulated(["cn"], ShapeTossSettings(mass=0.37))
    tilt, point, corners, hausdorff = row[2:6]
    assert float(tilt) < 0.05
    assert float(point) < 0.1
    assert corners == "8 + 8"
    assert max(map(float, hausdorff.split(", "))) < 1.2
    assert float(row[12]) < 1.3
