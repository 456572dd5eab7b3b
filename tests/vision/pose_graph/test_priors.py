"""Prior knowledge: what is exact, and when time steps share unknowns."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from tests.vision.sights import filmed_tumble
from tossid.objects import ObjectModel
from tossid.vision.cameras.rig import default_rig
from tossid.vision.pose_graph.priors import STEPS, Prior, body_key, calibrates, camera_key, joint_key, priors, tag_key
from tossid.vision.pose_graph.scene import observe
from tossid.vision.setup.layout import layout_of


def test_a_pose_is_exact_up_to_two_micrometres() -> None:
    assert Prior(np.eye(4), None).exact
    assert Prior(np.eye(4), 1e-6**2 * np.eye(6)).exact
    assert not Prior(np.eye(4), np.diag([0, 0, 0, 0, 0, 1e-3**2])).exact


def test_keys_are_different() -> None:
    keys = {make(i) for make in (camera_key, tag_key) for i in range(3)}
    keys |= {make(b, step) for make in (body_key, joint_key) for b in range(3) for step in (0, 1, STEPS - 1)}
    assert len(keys) == 2 * 3 + 2 * 3 * 3


def test_what_is_given_without_noise_is_not_calibrated(tagged: ObjectModel) -> None:
    cameras, layout = default_rig(), layout_of(tagged)
    detections, _ = filmed_tumble(cameras, tagged, np.random.default_rng(0), n=3)
    scene = observe(detections, cameras, layout, dropped=Counter())
    assert not calibrates(scene, priors(scene))
    lost = (replace(cameras[0], T_rig_cam=None), *cameras[1:])
    scene = observe(detections, lost, layout, dropped=Counter())
    assert camera_key(0) not in priors(scene)
    assert calibrates(scene, priors(scene))
    still = replace(layout, bodies=(*layout.bodies[:-1], replace(layout.bodies[-1], stillness=(1e-3, 1e-3))))
    scene = observe(detections, cameras, still, dropped=Counter())
    assert calibrates(scene, priors(scene))
