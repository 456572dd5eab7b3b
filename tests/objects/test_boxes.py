"""A box: mass, inertia and corners of a solid of even density."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest

from tossid.errors import ConfigError
from tossid.objects import box


def test_it_has_the_inertia_of_a_solid_box() -> None:
    edges = np.array([0.2, 0.1, 0.06])
    model = box("brick", edges, 0.5, friction=0.3)
    # the second moments of points that fill it evenly
    axis = (np.arange(60) + 0.5) / 60 - 0.5
    points = np.array(list(product(axis, axis, axis))) * edges
    inertia = 0.5 * np.mean((points**2).sum(axis=1)) * np.eye(3) - 0.5 * points.T @ points / len(points)
    np.testing.assert_allclose(model.inertia[0], inertia, rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(np.ptp(model.corner_pos, axis=0), edges, rtol=1e-12)
    assert (model.mass.item(), model.friction, model.width) == (0.5, 0.3, 0.2)


def test_its_centre_of_mass_may_lie_elsewhere_inside() -> None:
    assert box("brick", (0.2, 0.1, 0.06), 0.5, com=(0.02, 0, -0.01)).com[0].tolist() == [0.02, 0, -0.01]


@pytest.mark.parametrize(
    ("changes", "says"),
    [({"com": (0.2, 0, 0)}, "com: .* lies outside the box"), ({"name": "a b"}, "name: 'a b' will not do")],
)
def test_what_is_no_box_is_said(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        box(**{"name": "brick", "edges": (0.2, 0.1, 0.06), "mass": 0.5, **changes})
