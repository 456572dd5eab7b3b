"""Random starts, and how far apart trainings end."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from experiments.random_starts import end_difference
from tossid.models import TrainedModel
from tossid.objects import ObjectModel


def test_ends_are_compared_both_ways_over_what_was_seen(cube: ObjectModel) -> None:
    def trained(corners: np.ndarray, seen: list[bool], friction: float) -> TrainedModel:
        parameters: dict[str, Any] = {"geometry": [{"vertices_m": corners.tolist(), "seen": seen}]}
        found = SimpleNamespace(parameters=parameters, object=cube.with_changes(friction=friction))
        return cast(TrainedModel, found)

    whole = trained(cube.corner_pos, [True] * 8, 0.18)
    fewer = trained(cube.corner_pos[:7], [True] * 7, 0.2)
    assert end_difference(whole, whole) == (0.0, 0.0)
    for one, two in ((whole, fewer), (fewer, whole)):
        end = end_difference(one, two)
        assert end.corners == pytest.approx(cube.width)
        assert end.friction == pytest.approx(0.02)
    moved = cube.corner_pos.copy()
    moved[0] += 0.05
    assert end_difference(whole, trained(moved, [False] + [True] * 7, 0.18)).corners == pytest.approx(cube.width)
    extra = trained(np.vstack([cube.corner_pos, [[0.0, 0.0, 0.0]]]), [True] * 8 + [False], 0.18)
    assert end_difference(whole, extra).corners == 0.0
