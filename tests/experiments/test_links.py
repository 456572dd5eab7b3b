"""What `experiments.links` measures."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.links import simulated, toss_links
from tossid.motion.hinge import find_hinge
from tossid.objects import unstated_object
from tossid.rotations import quat_to_matrix


@pytest.mark.parametrize("engine", ["mujoco", "lcp"])
def test_links_land_on_their_corners_and_keep_their_hinge(engine: str) -> None:
    made = toss_links(engine, tosses=3)
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
    off = np.concatenate([a.q[:, :3] - b.q[:, :3] for a, b in zip(made.tracks[0], made.truth[0], strict=True)])
    assert off.std() == pytest.approx(1.5e-4, rel=0.2)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.* tosses have defects")
def test_an_elbow_is_learned_about_as_well_as_the_truth_predicts() -> None:
    row = simulated({"model": "cn", "engine": "mujoco", "seed": 0})
    assert float(row["hinge: axis [deg]"]) < 0.05
    assert float(row["point [mm]"]) < 0.1
    assert row["corners"] == "8 + 8"
    assert max(map(float, row["Hausdorff [mm]"].split(", "))) < 1.2
    assert float(row["over the true model's"]) < 1.3
