"""What `make shapes` measures."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.shapes import apart
from tests.objects.test_roundness import geom
from tossid.types import PoseTrack


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
