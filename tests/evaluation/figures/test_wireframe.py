"""Wireframes have the edges of a body, and views show them from their side."""

from __future__ import annotations

import numpy as np

from tossid.evaluation.figures.wireframe import view_from, wireframe
from tossid.objects import ObjectModel


def test_a_cube_has_twelve_edges_and_nine_are_seen(cube: ObjectModel) -> None:
    frame = wireframe(cube.corner_pos)
    lengths = np.linalg.norm(np.diff(cube.corner_pos[frame.edges], axis=1)[:, 0], axis=1)
    np.testing.assert_allclose(lengths, np.full(12, 0.1048))
    identity = np.array([1.0, 0, 0, 0])
    assert frame.visible(identity, view_from(0.5, 0.4).toward).sum() == 9
    assert len(wireframe(cube.corner_pos[:3]).edges) == 3, "a flat body is drawn all the same"


def test_a_view_keeps_up_and_right() -> None:
    view = view_from(-np.pi / 2, 0.0)  # from the front
    np.testing.assert_allclose(view(np.eye(3)), [[1, 0], [0, 0], [0, 1]], atol=1e-12)
    np.testing.assert_allclose(view.toward, [0, -1, 0], atol=1e-12)
