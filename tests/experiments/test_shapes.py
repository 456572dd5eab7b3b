"""What `experiments.shapes` tosses and measures."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.shapes import SHAPES, apart, shape, tossed
from tests.objects.test_roundness import geom
from tossid.rotations import quat_to_matrix
from tossid.types import PoseTrack


@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_lands_on_its_hull(name: str) -> None:
    model = shape(name)
    made = tossed(model, "mujoco", tosses=2, step=2e-4)
    for toss in made.truth.tosses:
        lowest = toss.q[:, 2] + (quat_to_matrix(toss.q[:, 3:7])[:, 2] @ model.hull_points().T).min(axis=1)
        assert -2e-3 < lowest.min() < 1e-3
        assert lowest[0] == pytest.approx(0.25, abs=3e-4)  # a round one's hull is that of points
    noise = np.concatenate([a.q[:, :3] - b.q[:, :3] for a, b in zip(made.tosses, made.truth.tosses, strict=True)])
    assert noise.std() == pytest.approx(1.5e-4, rel=0.2)
    assert (np.linalg.eigvalsh(model.inertia) > 0).all()


def test_only_what_came_near_the_ground_counts() -> None:
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    learned = geom('type="box" size="0.05 0.05 0.05"').with_changes(corner_pos=signs * [0.05, 0.05, 0.05])
    grown = learned.with_changes(corner_pos=learned.corner_pos + np.where(signs[:, 2:] > 0, [0, 0, 0.01], 0))
    q = np.tile([0, 0, 0.05, 1.0, 0, 0, 0], (2, 1))  # it lies on its lower face
    truth = [PoseTrack("one", np.array([0.0, 0.01]), q)]
    off, share = apart(grown, signs * 0.05, truth)
    assert off == pytest.approx(0, abs=1e-9)
    assert 0.4 < share < 0.6
    shifted = learned.with_changes(corner_pos=learned.corner_pos + np.where(signs[:, 2:] < 0, [0, 0, -0.01], 0))
    assert apart(shifted, signs * 0.05, truth)[0] == pytest.approx(0.01, rel=0.02)
