"""The corners that stand out are the hull's, and few."""

from __future__ import annotations

import numpy as np
import pytest

from tests.objects.meshes import TURNED, divided_box
from tossid.errors import ObjectError
from tossid.objects.files.outline import hull_vertices, outline
from tossid.objects.roundness import directions


@pytest.mark.parametrize("size", [1e-3, 0.1, 50.0])
def test_divided_faces_leave_the_box(size: float) -> None:
    corners = size * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) @ TURNED
    points = (divided_box((2 * size, 2 * size, 2 * size), 9)[0] @ TURNED).astype(np.float32).astype(float)
    assert len(hull_vertices(points)) > 8  # single precision bends the faces
    found = outline(points)
    assert len(found) == 8
    assert np.linalg.norm(found[:, None] - corners[None], axis=-1).min(axis=0).max() < 1e-6 * size


def test_a_cylinder_keeps_its_rims() -> None:
    angle = np.arange(48) * np.pi / 24
    rings = [np.column_stack([0.03 * np.cos(angle), 0.03 * np.sin(angle), z + 0 * angle]) for z in (-0.04, 0.01, 0.04)]
    assert len(outline(np.concatenate(rings))) == 96


def test_of_a_ball_the_farthest_of_many_vertices_stay() -> None:
    ball = 0.05 * directions(20_000)
    found = outline(ball)
    assert len(found) <= 2000
    ways = directions(3001)
    lower = (ball @ ways.T).max(axis=0) - (found @ ways.T).max(axis=0)
    assert lower.min() >= -1e-12
    assert lower.max() < 1e-3 * 0.1


def test_what_spans_no_volume_is_refused() -> None:
    flat = np.random.default_rng(0).normal(size=(30, 3)) * [1, 1, 0]
    for points in (flat, flat[:3], flat[:1]):
        with pytest.raises(ObjectError, match="span no volume"):
            outline(points)
