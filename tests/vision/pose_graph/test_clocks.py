"""Clocks that are apart are found and subtracted; clocks that agree are left alone."""

from __future__ import annotations

import numpy as np
import pytest

from tests.vision.sights import filmed_tumble, nees, seen, tumble
from tests.vision.tracked import track
from tossid.objects import ObjectModel
from tossid.vision.cameras.rig import default_rig


@pytest.mark.parametrize("delay", [0.0405, -0.0213])
def test_a_late_clock_is_estimated_and_subtracted(tagged: ObjectModel, delay: float):
    rng, cameras = np.random.default_rng(0), default_rig()
    t, q = tumble(8 * 220, rng, rate_hz=8 * 148)
    detections = []
    for i in range(40, 200):
        for camera in cameras:
            k, off = (8 * i + 3, delay) if camera.name == "cam2" else (8 * i, 0.0)  # it also exposes in between
            detections += seen([camera], tagged, t[k] + off, q[k], rng, 0.1)
    found, report = track(detections, cameras, tagged)
    (name, (offset, sigma)) = next(iter(report.clocks.items()))
    assert list(report.clocks) == ["cam2"]
    assert offset == pytest.approx(delay, abs=max(5 * sigma, 1e-4))
    assert sigma < 1e-4
    assert name == "cam2"
    truth = q[np.clip(np.round(found.t * 8 * 148).astype(int), 0, len(q) - 1)]
    assert np.median(np.linalg.norm(found.q[:, :3] - truth[:, :3], axis=1)) < 0.3e-3
    assert np.mean(nees(found, truth)) < 1.5


def test_clocks_that_agree_are_left_alone(tagged: ObjectModel):
    cameras = default_rig()
    detections, _ = filmed_tumble(cameras, tagged, np.random.default_rng(1), n=160)
    _, report = track(detections, cameras, tagged)
    assert report.clocks == {}
    assert report.suspects == []
