"""Shapes tossed in MuJoCo, and by the exact contact."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.tossed_shapes import SHAPES, ShapeTossSettings, toss_shape
from tossid.objects.roundness import directions
from tossid.rotations import quat_to_matrix


@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_lands_on_its_hull(name: str) -> None:
    made = toss_shape(name, ShapeTossSettings(tosses=2, step=2e-4))
    for track in made.truth:
        R = quat_to_matrix(track.q[:, 3:7])
        lowest = track.q[:, 2] + (R[:, 2] @ made.hull.T).min(axis=1)
        assert -2e-3 < lowest.min() < 1e-3
        assert lowest[0] == pytest.approx(0.25, abs=1e-4)
    noise = np.concatenate([a.q[:, :3] - b.q[:, :3] for a, b in zip(made.tracks, made.truth, strict=True)])
    assert noise.std() == pytest.approx(1.5e-4, rel=0.2)
    assert (np.linalg.eigvalsh(made.object.inertia) > 0).all()


def test_both_engines_toss_alike_until_the_ground() -> None:
    """And the exact contact does not sink in."""
    one, two = (toss_shape("wedge", ShapeTossSettings(tosses=3, engine=engine)) for engine in ("mujoco", "lcp"))
    for a, b in zip(one.truth, two.truth, strict=True):
        low = a.q[:, 2] + (quat_to_matrix(a.q[:, 3:7])[:, 2] @ one.hull.T).min(axis=1)
        flight = int(np.argmax(low < 0.02))
        assert flight > 20
        # one engine moves a step with the velocity at its end, the other with the mean
        assert b.q[:flight] == pytest.approx(a.q[:flight], abs=2e-3)
        lowest = b.q[:, 2] + (quat_to_matrix(b.q[:, 3:7])[:, 2] @ two.hull.T).min(axis=1)
        assert lowest.min() > -1e-5


def test_the_object_of_a_shape_reaches_as_far_as_its_hull() -> None:
    """Also where a mesh stands for something round."""
    ways = directions(300)
    for name in ("wedge", "ellipsoid", "rounded disc"):
        made = toss_shape(name, ShapeTossSettings(tosses=1, step=1e-3))
        assert made.object.support(ways).max(axis=1) == pytest.approx((ways @ made.hull.T).max(axis=1), abs=2e-4)
