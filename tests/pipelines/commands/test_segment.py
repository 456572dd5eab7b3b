"""`tossid segment`, the last of the three stages of ingest."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipelines.files.project import newest_recording
from tossid.store import read_dataset


def test_the_three_stages_give_what_ingest_gives(film: Path, monkeypatch: pytest.MonkeyPatch, answer: Any) -> None:
    monkeypatch.chdir(film)
    whole = answer("ingest", "out=whole.h5")
    detected = answer("detect")
    tracked = answer("track")
    parts = answer("segment", "out=parts.h5")
    assert parts["n_frames"] == whole["n_frames"]
    for one, other in zip(read_dataset(Path("whole.h5")).tosses, read_dataset(Path("parts.h5")).tosses, strict=True):
        np.testing.assert_array_equal(one.q, other.q)
        np.testing.assert_array_equal(one.v_cov, other.v_cov)
    assert answer("info", detected["out"])["n_detections"] == detected["n_detections"]
    assert answer("info", tracked["out"])["n_frames"] == tracked["n_poses"]
    assert answer("info", tracked["tum"])["n_frames"] == tracked["n_poses"]
    assert answer("info", str(newest_recording()))["object"] == "cube"
