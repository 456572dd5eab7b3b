"""`tossid track` of a recording as TagSLAM has it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tossid.vision.setup.calibration import read_cameras


def test_a_tagslam_set_up_is_tracked_as_it_is(project: Path, shared_data: Path, answer: Any) -> None:
    """From TagSLAM's folder: poses of its wand, and the calibration that the graph found, in TagSLAM's own form."""
    found = answer("track", f"recording={shared_data / 'tagslam_test' / 'test_4'}", "out=wand.npz")
    assert found["bodies"] == {"wand": 101}
    assert found["n_poses"] == found["n_steps"] == 101
    assert found["dropped_tags"]["id on no body"] == 21757
    assert set(found["cameras"]) == {f"cam{i}" for i in range(8)}
    assert found["problems"] == []
    assert len((project / "wand.txt").read_text().splitlines()) == 102
    cameras = read_cameras(project / "wand_set_up")
    assert len(cameras) == 8
    assert all(camera.T_rig_cam_cov is not None for camera in cameras)


@pytest.mark.slow
def test_clocks_that_agree_change_nothing(project: Path, shared_data: Path, answer: Any) -> None:
    """TagSLAM's eight cameras share a clock: estimated or not, the errors are the same."""
    keys = ["track", f"recording={shared_data / 'tagslam_test' / 'test_4'}"]
    found, without = answer(*keys, "out=wand.npz"), answer(*keys, "out=again.npz", "track.clocks=false")
    assert without["rms"] == found["rms"]
