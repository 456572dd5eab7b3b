"""What `make links` measures."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiments.links import parsed, simulated
from tossid.settings.synthesis import ShapeTossSettings


def test_arguments_say_how_links_are_tossed_or_what_was_recorded() -> None:
    models, recorded, settings = parsed(["cn", "--engine", "lcp", "--seed", "2", "--tosses", "30"])
    assert (models, recorded) == (["cn"], None)
    assert settings == ShapeTossSettings(engine="lcp", seed=2, tosses=30, mass=0.37)
    assert parsed(["--recorded", "elbow.h5"])[:2] == (["cn", "cnrpi"], Path("elbow.h5"))


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
