"""The shapes of two links of which one may keep the other off the ground."""

from __future__ import annotations

import numpy as np
import pytest

from tests.models.made import tosses
from tossid.motion.links import body_tracks
from tossid.objects import ObjectModel
from tossid.objects.convex_shape import ConvexShape, polytope
from tossid.objects.half_spaces import half_spaces
from tossid.objects.linked_shapes import contacts_alone, find_linked_shapes
from tossid.settings.objects import ShapeSettings
from tossid.types import PoseTrack

AXES = (np.array([0.0, 1.0, 0.0]), np.array([0.0, 1.0, 0.0]))


@pytest.fixture(scope="module")
def links(elbow: ObjectModel) -> list[list[PoseTrack]]:
    return body_tracks(elbow, tosses(elbow, 40, seed=3, frames=90, substeps=2))


@pytest.fixture(scope="module")
def shapes(links: list[list[PoseTrack]]) -> tuple[ConvexShape, ...]:
    return find_linked_shapes(links, AXES)


def test_every_corner_is_where_it_is(shapes: tuple[ConvexShape, ...], elbow: ObjectModel) -> None:
    for body, shape in enumerate(shapes):
        true = elbow.corner_pos[elbow.corner_body == body]
        distance = np.linalg.norm(true[:, None] - shape.vertices[None], axis=-1)
        assert shape.vertices.shape == (8, 3)
        assert distance[:, shape.frames > 0].min(axis=0).max() < 1e-3
        assert distance.min(axis=1).max() < 5e-3


def test_corners_at_the_hinge_that_never_touch_are_said_to_have_no_contact(
    shapes: tuple[ConvexShape, ...], links: list[list[PoseTrack]]
) -> None:
    """They face the other link, nearer to the hinge than what touches."""
    alone = contacts_alone(links, shapes)
    inner = [(0.0, 0.0), (0.025, 0.0)]
    for shape, counts, (_, y), sign in zip(shapes, alone, inner, (1, -1), strict=True):
        never = shape.frames == 0
        assert np.isinf(shape.deviation[never]).all()
        assert (counts[~never] > 0).all()
        assert (sign * shape.vertices[never, 1] > 0).all(), y
    assert sum((shape.frames == 0).sum() for shape in shapes) > 0


def test_alone_each_link_would_reach_through_the_other(links: list[list[PoseTrack]], elbow: ObjectModel) -> None:
    """What the joint criterion is for: the half-spaces of one link are tight where the other touches."""
    true = elbow.corner_pos[elbow.corner_body == 0]
    _, alone, _, _ = polytope(half_spaces(links[0]), ShapeSettings())
    assert np.linalg.norm(true[:, None] - alone.vertices[None], axis=-1).min(axis=0).max() > 0.03
