"""Shapes and linked shapes tossed in MuJoCo, and by the exact contact."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.tossed_links import toss_links
from experiments.tossed_shapes import SHAPES, ShapeTossSettings, toss_shape
from tossid.motion.hinge import find_hinge
from tossid.objects import unstated_object
from tossid.rotations import quat_to_matrix


@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_lands_on_its_hull(name: str) -> None:
    made = toss_shape(name, ShapeTossSettings(tosses=2, step=2e-4))
    for track in made.truth:
        R = quat_to_matrix(track.q[:, 3:7])
        lowest = track.q[:, 2] + (R[:, 2] @ made.hull.T).min(axis=1)
        assert -2e-3 < lowest.min() < 1e-3
        assert lowest[0] == pytest.approx(0.25, abs=1e-4)
    noise = np.concatenate([a.q[:, :3] - b.q[:, :3] for a, b in zip(made.tracks, made.truth, strict=True)])
    assert noise.std() == pytest.approx(1.5e-4, rel=0.2)
    assert (np.linalg.eigvalsh(made.object.inertia) > 0).all()


@pytest.mark.parametrize("engine", ["mujoco", "lcp"])
def test_links_land_on_their_corners_and_keep_their_hinge(engine: str) -> None:
    made = toss_links(ShapeTossSettings(tosses=3, engine=engine, step=2e-4, frames=90))
    found = find_hinge(*made.truth)
    point, axis = made.hinge()
    assert abs(found.hinge.axis @ axis) == pytest.approx(1, abs=1e-9)
    assert np.cross(found.hinge.pos - point, axis) == pytest.approx(np.zeros(3), abs=1e-6)
    true = made.in_tracked_frames(unstated_object(hinge=found.hinge))
    for number in range(3):
        lowest = []
        for body, tracks in enumerate(made.truth):
            corners, q = true.corner_pos[true.corner_body == body], tracks[number].q
            lowest.append(q[:, 2] + (quat_to_matrix(q[:, 3:7])[:, 2] @ corners.T).min(axis=1))
        both = np.min(lowest, axis=0)
        assert both[0] == pytest.approx(0.25, abs=1e-6)
        assert -2e-3 < both.min() < 1e-3
    off = np.concatenate([a.q[:, :3] - b.q[:, :3] for a, b in zip(made.first, made.truth[0], strict=True)])
    assert off.std() == pytest.approx(1.5e-4, rel=0.2)
