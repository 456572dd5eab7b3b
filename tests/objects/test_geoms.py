"""Round objects as MJCF, and back."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tests.objects.test_roundness import geom
from tossid.objects import object_from_mjcf, to_mjcf
from tossid.objects.roundness import directions, disc


@pytest.mark.parametrize(
    "text",
    [
        'type="sphere" size="0.05" pos="0.01 0 0"',
        'type="capsule" size="0.02 0.04" euler="30 20 10"',
        'type="ellipsoid" size="0.06 0.045 0.035" euler="30 20 10"',
        'type="cylinder" size="0.05 0.03" euler="30 20 10" pos="0 0.02 0"',
    ],
)
def test_a_round_object_survives_mjcf(text: str) -> None:
    model, ways = geom(text), directions(200)
    again = object_from_mjcf(to_mjcf(model))
    assert again.support(ways).max(axis=1) == pytest.approx(model.support(ways).max(axis=1), abs=2e-5)
    assert mujoco.MjModel.from_xml_string(to_mjcf(model)).nbody == 2


def test_round_edges_become_a_mesh_of_many_points() -> None:
    model = geom('type="cylinder" size="0.05 0.01"')
    edge = disc(0.04, [0, 0, 1], edge=0.01)
    rounded = model.with_changes(corner_pos=np.zeros((3, 3)), corner_body=np.zeros(3, dtype=np.int64), roundness=edge)
    again, ways = object_from_mjcf(to_mjcf(rounded)), directions(300)
    assert again.n_corners > 300
    assert again.support(ways).max(axis=1) == pytest.approx(rounded.support(ways).max(axis=1), abs=4e-4)
