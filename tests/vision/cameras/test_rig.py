"""The default rig sees the whole toss area."""

from __future__ import annotations

import numpy as np

from tossid.vision.cameras.rig import default_rig


def test_the_default_rig_sees_the_whole_area():
    turn = np.linspace(0, 2 * np.pi, 40)
    for camera in default_rig(area=1.0, height=0.4):
        for z in (0.0, 0.4):
            points = np.column_stack([0.5 * np.cos(turn), 0.5 * np.sin(turn), np.full(40, z)])
            assert camera.contains(camera.project(points)).all()
