"""What a hand hides is not found, and nothing is found wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.vision.films import corner_rms, film_of
from tests.vision.tracked import track
from tossid.objects import ObjectModel
from tossid.rotations import geodesic_angle
from tossid.synthesis.timeline import Filming, Timeline
from tossid.vision.cameras.shutter import Shutter, poses_at
from tossid.vision.detection.detect import detect_frames
from tossid.vision.rendering.hand import hand_poses
from tossid.vision.rendering.render import Renderer


def test_what_a_hand_hides_is_not_found_and_nothing_is_found_wrong(
    tagged: ObjectModel, timeline: Timeline, rig, tmp_path: Path
):
    hand, reaches = hand_poses(
        timeline.t,
        timeline.q,
        lift=timeline.lift,
        release=timeline.release,
        rest=timeline.rest,
        holds=True,
        sweeps=1.0,
        cameras=rig,
        rng=np.random.default_rng(2),
    )
    assert {reach.kind for reach in reaches} == {"holds", "sweeps"}
    release = timeline.t[timeline.release[0]]
    assert all(np.isfinite(hand[(timeline.t >= r.t0) & (timeline.t <= r.t1)]).all() for r in reaches)
    recording, truth = film_of(timeline, tagged, rig, tmp_path / "r", Filming(hand=hand))
    renderer = Renderer(tagged, rig)
    held = np.flatnonzero((timeline.t > release - 0.2) & (timeline.t < release))
    clear = np.array(
        [[renderer.visible(Shutter().expose(timeline.t, timeline.q, i, 384, 8), c.name) for c in rig] for i in held]
    )
    # it is held, not wrapped up
    assert 0.2 * clear.sum() < truth.visible[held].sum() < 0.8 * clear.sum()
    index = {(camera.name, round(t * 1e9)): (i, c) for c, camera in enumerate(rig) for i, t in enumerate(timeline.t)}
    detections = list(detect_frames(recording, tagged))
    shares = []
    for d in detections:
        i, c = index[d.camera, round(d.t * 1e9)]
        shares.append(truth.visible[i, c, d.tag_id])
        assert corner_rms(d, recording, tagged, timeline) < 2.0
    assert min(shares) > 0.6  # a tag can spare a little of its edge
    poses, _ = track(detections, recording.cameras, tagged)
    true = poses_at(timeline.t, timeline.q, poses.t)
    off = poses.q[:, :3] - true[:, :3]
    assert np.linalg.norm(off, axis=1).max() < 0.01
    nees = np.einsum("ni,nij,nj->n", off, np.linalg.inv(poses.q_cov[:, :3, :3]), off) / 3
    assert nees.max() < 12.0  # a pose that is less sure says so
    assert nees.mean() < 1.6
    assert np.rad2deg(geodesic_angle(poses.q[:, 3:7], true[:, 3:7])).max() < 4.0
