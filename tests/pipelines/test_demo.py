"""How the demo measures poses against the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipelines.demo import pose_errors
from tests.models.made import tosses
from tossid.objects import ObjectModel
from tossid.store import Dataset


def test_frames_are_compared_with_the_toss_of_the_same_time(cube: ObjectModel) -> None:
    first, second = tosses(cube, 2, seed=1, frames=20)
    second = replace(second, t=second.t + 1.0)
    truth = Dataset(cube, (first, second), 148.0, "made")
    q = second.q[5:15].copy()
    q[:, 0] += 1e-3
    part = replace(
        second, t=second.t[5:15], q=q, v=second.v[5:15], q_cov=second.q_cov[5:15], v_cov=second.v_cov[5:15],
        phase=second.phase[5:15],
    )  # fmt: skip
    distance, angle = pose_errors(truth, Dataset(cube, (part,), 148.0, "seen"))
    assert len(distance) == 10
    assert distance == pytest.approx(np.ones(10))
    assert angle == pytest.approx(np.zeros(10), abs=1e-6)
