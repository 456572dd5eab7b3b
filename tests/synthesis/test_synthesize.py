"""`tossid.synthesize`: a dataset with its truth, in memory or in a folder, repeatable by its seed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import tossid
from tossid.errors import ConfigError, InputError
from tossid.vision.recordings.formats.frames import read_recording

SMALL = {"tosses": 4, "seconds": 0.5, "engine": "lcp"}


def test_the_same_seed_gives_the_same_tosses() -> None:
    one, same, other = (tossid.synthesize("cube", **SMALL, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.tosses[0].q, same.tosses[0].q)
    assert not np.array_equal(one.tosses[0].q[0], other.tosses[0].q[0])


def test_a_folder_holds_what_is_returned(tmp_path: Path) -> None:
    dataset = tossid.synthesize("elbow", **SMALL, out=tmp_path / "made")
    again = tossid.read_dataset(tmp_path / "made" / "tosses.h5")
    truth = tossid.read_dataset(tmp_path / "made" / "truth.h5")
    for kept, given in ((again, dataset), (truth, dataset.truth)):
        assert kept.provenance == given.provenance
        for a, b in zip(kept.tosses, given.tosses, strict=True):
            np.testing.assert_array_equal(a.q, b.q)
            np.testing.assert_array_equal(a.v, b.v)
    assert tossid.objects.recorded_object(tmp_path / "made").name == "elbow"


def test_a_film_is_a_recording_of_its_truth(tmp_path: Path) -> None:
    shares: list[float] = []
    truth = tossid.synthesize(
        "cube",
        frames=True,
        out=tmp_path / "film",
        tosses=1,
        seconds=0.3,
        camera__count=1,
        camera__samples=2,
        pause_s=(0.05, 0.05),
        carry_s=(0.1, 0.1),
        progress=lambda text, share: shares.append(share),
    )
    recording = read_recording(tmp_path / "film")
    assert recording.n_frames > 30
    assert [camera.name for camera in recording.cameras] == ["cam0"]
    np.testing.assert_array_equal(truth.tosses[0].t, tossid.read_dataset(tmp_path / "film" / "truth.h5").tosses[0].t)
    assert shares[0] == 0.0
    assert shares[-1] == 1.0
    assert len(shares) > 3


@pytest.mark.parametrize(
    ("keys", "error", "says"),
    [
        ({"frames": True}, InputError, "frames are written to a folder"),
        ({"engine": "lpc"}, ConfigError, "there is no 'lpc'; expected one of lcp, mujoco.*'lcp'"),
        ({"tossses": 3}, ConfigError, "'tosses'"),
    ],
)
def test_a_call_that_cannot_be_is_said(keys: dict, error: type[Exception], says: str) -> None:
    with pytest.raises(error, match=says):
        tossid.synthesize("cube", **keys)


def test_tags_are_needed_for_a_film_only(tmp_path: Path) -> None:
    bare = tossid.objects.load_object("cube").with_changes(tags=())
    with pytest.raises(ConfigError, match="'cube' has no tags that a camera could see"):
        tossid.synthesize(bare, frames=True, out=tmp_path / "film")
    assert len(tossid.synthesize(bare, **SMALL).tosses) == 4
