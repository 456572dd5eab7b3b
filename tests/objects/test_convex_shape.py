"""Shapes that are known, from poses over the ground."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tossid.errors import InputError
from tossid.objects.convex_shape import find_shape
from tossid.rotations import matrix_to_quat, quat_to_matrix
from tossid.settings.objects import ShapeSettings
from tossid.types import Toss

WEDGE = 0.05 * np.array([[x, y, z] for x in (-1, 1) for y, z in ((-1, -0.6), (1, -0.6), (-1, 0.8))])
OFFSET = np.array([0.02, -0.01, 0.03])
"""Where the wedge is in its body's frame."""


def rolled(corners: np.ndarray, rng: np.random.Generator, *, tosses: int = 12, noise: float = 2e-4) -> list[Toss]:
    """Poses of a body that flies in every second frame, and touches the ground in the others."""
    found = []
    for number in range(tosses):
        R = Rotation.random(40, rng=rng).as_matrix()
        lowest = (R @ corners.T)[:, 2].min(axis=1)
        height = np.where(np.arange(40) % 2, 0.0, rng.uniform(0.01, 0.2, 40)) - lowest + noise * rng.normal(size=40)
        q = np.column_stack([rng.uniform(-0.5, 0.5, (40, 2)), height, matrix_to_quat(R)])
        zero = np.zeros((40, 6, 6))
        t = np.arange(40) / 100
        found.append(Toss(f"{number}", t, q, np.zeros((40, 6)), zero, zero, np.zeros(40, dtype=np.uint8)))
    return found


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """Hausdorff distance of two sets of points."""
    distance = np.linalg.norm(one[:, None] - other[None], axis=-1)
    return float(max(distance.min(axis=0).max(), distance.min(axis=1).max()))


@pytest.fixture(scope="module")
def wedge() -> list[Toss]:
    return rolled(WEDGE + OFFSET, np.random.default_rng(0))


def test_every_vertex_is_found_and_no_other(wedge: list[Toss]) -> None:
    shape = find_shape(wedge)
    assert shape.vertices.shape == WEDGE.shape
    assert apart(shape.vertices, WEDGE + OFFSET) < 1e-3
    assert (shape.deviation < 1e-3).all()
    assert shape.frames.sum() > 150
    assert shape.misfit < 6e-4


def test_a_ground_that_is_higher_and_tilted_is_told(wedge: list[Toss]) -> None:
    def moved(toss: Toss) -> Toss:
        q = toss.q.copy()
        q[:, 2] += 1.5e-3 + 2e-3 * q[:, 0]
        return Toss(toss.name, toss.t, q, toss.v, toss.q_cov, toss.v_cov, toss.phase)

    ground = find_shape([moved(toss) for toss in wedge]).ground
    assert ground[0] == pytest.approx(1.5e-3, abs=4e-4)
    assert ground[1] == pytest.approx(2e-3, abs=8e-4)


def test_moments_are_those_of_a_box() -> None:
    half = np.array([0.03, 0.05, 0.07])
    box = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    shape = find_shape(rolled(box + OFFSET, np.random.default_rng(2), noise=0.0))
    volume, com, inertia = shape.solid()
    assert volume == pytest.approx(8 * half.prod(), rel=0.02)
    assert com == pytest.approx(OFFSET, abs=5e-4)
    expected = (half[[1, 2, 0]] ** 2 + half[[2, 0, 1]] ** 2) / 3
    assert np.diag(inertia) == pytest.approx(expected, rel=0.03)
    assert shape.mean_width == pytest.approx(half.sum(), rel=0.02)  # of a box: half the sum of its edges


def test_what_no_contact_shows_is_marked() -> None:
    rng = np.random.default_rng(3)
    upright = rolled(WEDGE, rng, tosses=40)
    R = [quat_to_matrix(toss.q[:, 3:7]) for toss in upright]
    tip = WEDGE[2]  # frames in which this corner is the lowest are left out
    kept = []
    for toss, turn in zip(upright, R, strict=True):
        lowest = (turn @ WEDGE.T)[:, 2].argmin(axis=1)
        keep = np.linalg.norm(WEDGE[lowest] - tip, axis=1) > 1e-9
        n = int(keep.sum())
        zero = np.zeros((n, 6, 6))
        kept.append(Toss(toss.name, toss.t[keep], toss.q[keep], np.zeros((n, 6)), zero, zero, toss.phase[keep]))
    shape = find_shape(kept)
    assert np.linalg.norm(shape.vertices - tip, axis=1).min() > 5e-3
    assert len(shape.unseen) > 0
    assert np.linalg.norm(shape.unseen - tip, axis=1).min() < np.linalg.norm(shape.vertices - tip, axis=1).min()


def test_fewer_contacts_than_asked_for_show_no_shape(wedge: list[Toss]) -> None:
    with pytest.raises(InputError, match="contacts with the ground in 3 tosses"):
        find_shape(wedge[:3], ShapeSettings(fewest_contacts=1000))


def test_too_few_sides_bound_no_shape(wedge: list[Toss]) -> None:
    one = wedge[0]
    still = Toss("still", one.t, np.repeat(one.q[1:2], len(one), axis=0), one.v, one.q_cov, one.v_cov, one.phase)
    with pytest.raises(InputError, match="too few sides"):
        find_shape([still])
