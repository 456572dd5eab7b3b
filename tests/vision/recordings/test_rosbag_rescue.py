"""A bag that breaks off is read as far as it is whole."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.vision.bags import CAMERAS, write_bag
from tossid.vision.recordings.formats.bags import read_bag_detections


@pytest.mark.parametrize("share", [0.3, 0.7, 0.98])
def test_a_truncated_bag_is_read_as_far_as_it_is_whole_and_reported(tmp_path: Path, share: float):
    path = write_bag(tmp_path, 1)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    found = read_bag_detections(path, CAMERAS, sigma=1.0)
    assert 0.5 * share * 40 < len(found.detections) <= 40
    assert len(found.detections) == sum(found.n_frames.values())
    (problem,) = found.problems
    assert "breaks off" in problem
    assert "messages are whole" in problem
