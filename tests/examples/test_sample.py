"""The recording that ships: its size, what lies in it, and that its gap has a name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

import tossid
from experiments.sample import FILMED, MOST_BYTES, WORLD
from pipelines.demo_page import pose_errors

SAMPLE = Path(__file__).parents[2] / "data" / "raw" / "sample"
DATASET, TRUTH = (tossid.read_dataset(SAMPLE / name) for name in ("tosses.h5", "truth.h5"))


def test_the_sample_is_small() -> None:
    assert sum(path.stat().st_size for path in SAMPLE.rglob("*") if path.is_file()) < MOST_BYTES


def test_the_frames_are_those_of_the_first_tosses() -> None:
    for camera in ("cam0", "cam1"):
        last = max(int(path.stem) for path in (SAMPLE / "frames" / camera).iterdir())
        assert TRUTH.tosses[FILMED - 1].t[-1] < 1e-9 * last < TRUTH.tosses[FILMED].t[0]


def test_the_dataset_has_all_tosses_and_says_what_made_it() -> None:
    assert len(DATASET.tosses) == len(TRUTH.tosses) == WORLD.tosses
    assert DATASET.provenance["command"] == "python -m experiments.sample"
    distance, turn = pose_errors(TRUTH, DATASET)
    assert np.median(distance) < 0.2
    assert np.median(turn) < 0.2
    assert yaml.safe_load(TRUTH.provenance["config"])["effects"] == WORLD.effects


@pytest.mark.slow
def test_the_gap_of_the_sample_has_a_name() -> None:
    gap = tossid.diagnose(DATASET, simulator="nominal")
    assert gap.named == ("friction",)
    finding = gap.finding("friction")
    assert finding is not None
    assert finding.parameters["mu"].value == pytest.approx(WORLD.effects["friction"]["mu"], rel=0.02)
