"""Effects of the body: rounded corners by hand, and the inertia of links."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.physics.worlds import DT, HALF, flat, run
from tossid.objects import ObjectModel
from tossid.physics.effects import Law, World, effects_for

Array = NDArray[np.float64]


def test_a_cube_whose_corners_are_one_ball_rolls_as_a_ball(cube: ObjectModel) -> None:
    """Down a slope b without slipping: a = g sin(b) / (1 + I / (m r²))."""
    slope, m, inertia = 0.05, float(cube.mass[0]), float(cube.inertia[0, 1, 1])
    ball = cube.with_changes(corner_pos=HALF * np.sign(cube.corner_pos), friction=1.0)
    world = World(ball, ground_tilt=(0.0, slope), law=Law(rounding=HALF))
    done = run(world, flat(), [0.0] * 6, seconds=44 * DT)
    expected = 9.81 * np.sin(slope) / (1 + inertia / (m * HALF**2))
    assert done.v[0, -1, 0] / (44 * DT) == pytest.approx(expected, rel=1e-3)
    assert done.v[0, -1, 4] * HALF == pytest.approx(done.v[0, -1, 0], rel=1e-6)
    np.testing.assert_allclose(done.q[0, :, 2], HALF, atol=1e-6)


def test_an_edge_with_rounded_corners_stands_lower(cube: ObjectModel) -> None:
    """Balanced on an edge, the centre is at sqrt(2) (a - r) + r; on a face it is at a."""
    radius, turned = 0.006, np.array([np.cos(np.pi / 8), np.sin(np.pi / 8), 0.0, 0.0])
    height = np.sqrt(2) * (HALF - radius) + radius
    world = World(cube, law=Law(rounding=radius))
    on_edge = run(world, np.concatenate([[0, 0, height], turned]), [0.0] * 6, seconds=0.05)
    np.testing.assert_allclose(on_edge.q[0, :, 2], height, atol=1e-5)
    on_face = run(world, flat(), [0.0] * 6, seconds=0.05)
    np.testing.assert_allclose(on_face.q[0, :, 2], HALF, atol=1e-7)


def test_the_inertia_of_links_may_be_of_another_shape(cube: ObjectModel, elbow: ObjectModel) -> None:
    of_links, of_a_body = ({e.name: e for e in effects_for(model)}["inertia"] for model in (elbow, cube))
    world = World(elbow)
    same = of_links.at(world, of_links.nominal(world))
    np.testing.assert_allclose(same.object.inertia, elbow.inertia, rtol=1e-12)
    larger = of_links.at(world, np.array([1.3, 1.0, 1.0])).object.inertia
    np.testing.assert_allclose(larger, of_a_body.at(world, np.array([1.3])).object.inertia, rtol=1e-12)

    # a solid box of 1, 2, 3 becomes one of 1, 4, 1.5
    box = 0.1 * np.array([1.0, 4.0, 9.0]) / 12
    moments = np.diag(box.sum() - box)
    boxes = World(elbow.with_changes(inertia=np.tile(moments, (2, 1, 1))))
    found = of_links.at(boxes, np.array([1.0, 4.0, 0.25])).object.inertia
    other = 0.1 * np.array([1.0, 16.0, 2.25]) / 12
    np.testing.assert_allclose(found, np.tile(np.diag(other.sum() - other), (2, 1, 1)), atol=1e-15)
    for least in ([5.0, 0.05, 0.05], [0.2, 10.0, 0.05], [1.0, 10.0, 10.0]):
        a, b, c = np.linalg.eigvalsh(of_links.at(world, np.array(least)).object.inertia[1])
        assert 0 < a <= b <= c < a + b
