"""Robust estimation: an outlier is left out, the residuals' noise scales covariances, frames' own times are used."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from tests.vision.sights import filmed_tumble, seen, tumble
from tossid.objects import ObjectModel
from tossid.settings.tracking import TrackSettings
from tossid.types import Detection
from tossid.vision.cameras.rig import default_rig
from tossid.vision.pose_graph.robust import SolvedScene, solve_scene
from tossid.vision.pose_graph.scene import observe
from tossid.vision.setup.layout import layout_of


def _solved(detections: list[Detection], model: ObjectModel, offsets: dict[int, float] | None = None) -> SolvedScene:
    scene = observe(detections, default_rig(), layout_of(model), dropped=Counter())
    return solve_scene(scene, offsets or {}, settings=TrackSettings())


def test_one_shifted_tag_is_the_only_outlier(tagged: ObjectModel) -> None:
    detections, _ = filmed_tumble(default_rig(), tagged, np.random.default_rng(0), n=40)
    wrong = len(detections) // 2
    shifted = list(detections)
    shifted[wrong] = replace(shifted[wrong], corners=shifted[wrong].corners + np.array([25.0, -10.0]))
    solved = _solved(shifted, tagged)
    out = np.flatnonzero(~solved.used)
    assert solved.outliers == len(out) == 1
    assert solved.scene.tag[out[0]] == [tag.id for tag in solved.scene.tags].index(shifted[wrong].tag_id)
    assert not solved.suspects


@pytest.mark.parametrize("understated", [1.0, 3.0])
def test_covariances_follow_the_residuals_noise(tagged: ObjectModel, understated: float) -> None:
    detections, _ = filmed_tumble(default_rig(), tagged, np.random.default_rng(1), n=60)
    honest = _solved(detections, tagged)
    solved = _solved([replace(d, corner_cov=d.corner_cov / understated**2) for d in detections], tagged)
    assert solved.scale == pytest.approx(understated, rel=0.05)
    moving = next(b for b, body in enumerate(solved.scene.bodies) if not body.is_static)
    ratio = solved.solution.world_cov[moving] / honest.solution.world_cov[moving]
    assert np.median(ratio[:, range(6), range(6)]) == pytest.approx(1.0, abs=0.15)


def test_a_frame_that_is_late_within_its_step_is_used_at_its_own_time(tagged: ObjectModel) -> None:
    """A camera's frames 1.5 ms after the others', at up to 2 m/s and 5 rad/s: still the noise and no more."""
    rng, cameras = np.random.default_rng(2), default_rig()
    t, q = tumble(60 * 20, rng, rate_hz=148 * 20)
    detections = []
    for i in range(0, len(t) - 20, 20):
        for c, camera in enumerate(cameras):
            k = i + (4 if c == 1 else 0)
            detections += seen([camera], tagged, t[k], q[k], rng, 0.1)
    solved = _solved(detections, tagged)
    assert np.abs(solved.scene.delay).max() == pytest.approx(4 / 148 / 20)
    assert np.sqrt(np.mean(solved.errors.pixels[solved.used] ** 2)) < 1.15 * 0.1 * 2**0.5
