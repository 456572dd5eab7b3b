"""The recording that ships: its size, what lies in it, and that its gap has a name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

import tossid
from experiments.sample import FILMED, MOST_BYTES, WORLD
from pipelines.demo_page import pose_errors
from tossid.objects import corner_positions

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


def _of_one_camera(name: str, folder: Path) -> tossid.Dataset:
    """The sample as one camera has filmed it that stands anywhere: the stated place is left out."""
    for written in ("cameras.yaml", "tagslam.yaml"):
        content = yaml.safe_load((SAMPLE / written).read_text())
        kept = {name: content[name]} if written == "cameras.yaml" else content
        (folder / written).write_text(yaml.safe_dump(kept))
    (folder / "frames").mkdir()
    (folder / "frames" / name).symlink_to(SAMPLE / "frames" / name)
    return tossid.ingest(folder, object="cube", progress=lambda progress: None)  # (it warns that it turns the world)


def test_one_camera_that_stands_anywhere_shows_all_tosses(tmp_path: Path) -> None:
    dataset = _of_one_camera("cam1", tmp_path)
    assert len(dataset.tosses) == FILMED
    for toss, true in zip(dataset.tosses, TRUTH.tosses, strict=False):
        assert toss.t[0] == pytest.approx(true.t[0], abs=0.05)
        assert toss.t[-1] == pytest.approx(true.t[-1], abs=0.25)
        last = toss.q[-8:].mean(0)
        assert corner_positions(dataset.object, last)[:, 2].min() == pytest.approx(0.0, abs=3e-3)


@pytest.mark.slow
@pytest.mark.parametrize("camera", ["cam0", "cam1"])
def test_one_camera_shows_the_friction(camera: str, tmp_path: Path) -> None:
    finding = tossid.diagnose(_of_one_camera(camera, tmp_path), simulator="nominal").finding("friction")
    assert finding is not None
    mu, true = finding.parameters["mu"], WORLD.effects["friction"]["mu"]
    print(f"{camera}: friction {mu.value:.3f} ({mu.low:.3f} to {mu.high:.3f}) for {true}")
    assert mu.low < true < mu.high
    assert mu.high - mu.low < 0.03


@pytest.mark.slow
def test_the_gap_of_the_sample_has_a_name() -> None:
    gap = tossid.diagnose(DATASET, simulator="nominal")
    assert gap.named == ("friction",)
    finding = gap.finding("friction")
    assert finding is not None
    assert finding.parameters["mu"].value == pytest.approx(WORLD.effects["friction"]["mu"], rel=0.02)
