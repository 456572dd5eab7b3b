"""Volumes of bodies of known shape."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tossid.objects import ObjectModel
from tossid.objects.mjcf import object_from_mjcf
from tossid.objects.volume import hull_volume


def with_geom(geom: str) -> ObjectModel:
    return object_from_mjcf(
        f'<mujoco><worldbody><body name="it"><freejoint/><geom {geom} mass="0.6"/></body></worldbody></mujoco>'
    )


@pytest.mark.parametrize(
    ("geom", "expected"),
    [
        ('type="box" size="0.05 0.04 0.03"', 8 * 0.05 * 0.04 * 0.03),
        ('type="sphere" size="0.119"', 4 / 3 * np.pi * 0.119**3),
        ('type="capsule" size="0.03 0.1"', np.pi * 0.03**2 * 0.2 + 4 / 3 * np.pi * 0.03**3),
        ('type="cylinder" size="0.05 0.02"', np.pi * 0.05**2 * 0.04),
        ('type="ellipsoid" size="0.05 0.04 0.03"', 4 / 3 * np.pi * 0.05 * 0.04 * 0.03),
    ],
)
def test_shapes_have_their_volume(geom: str, expected: float) -> None:
    assert hull_volume(with_geom(geom)) == pytest.approx(expected, rel=0.01)


def test_links_add_up(elbow: ObjectModel) -> None:
    both = hull_volume(elbow)
    one = hull_volume(replace(elbow, corner_body=np.where(elbow.corner_body == 0, 0, 7)))
    assert 0 < one < both


def test_a_flat_body_has_no_volume(cube: ObjectModel) -> None:
    flat = replace(cube, corner_pos=cube.corner_pos * [1, 1, 0])
    assert hull_volume(flat) == 0.0
