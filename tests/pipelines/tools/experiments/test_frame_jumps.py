"""What a body frame that jumps leaves of a toss."""

from __future__ import annotations

import numpy as np
import pytest

from pipelines.tools.experiments.frame_jumps import moved
from tests.models.made import tosses
from tossid.objects import ObjectModel, corner_positions
from tossid.rotations import quat_exp, quat_to_matrix


def test_the_object_stays_where_it_is_in_the_world(cube: ObjectModel) -> None:
    (toss,) = tosses(cube, 1, seed=0, frames=5)
    shift, turn = np.array([0.01, -0.02, 0.03]), quat_to_matrix(quat_exp(np.array([0.0, np.deg2rad(30), 0.0])))
    seen_from_there = cube.with_changes(corner_pos=(cube.corner_pos - shift) @ turn)
    jumped = moved(toss, tuple(shift.tolist()), 30.0)
    assert corner_positions(seen_from_there, jumped.q) == pytest.approx(corner_positions(cube, toss.q))
