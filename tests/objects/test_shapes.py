"""Shapes that are known, from poses over the ground: polytopes, round shapes, links, and evidence against corners."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tests.models.made import toss_of, tosses
from tossid.errors import InputError
from tossid.motion.links import body_tracks
from tossid.objects import ObjectModel
from tossid.objects.convex_shape import ConvexShape, find_shape
from tossid.objects.half_spaces import HalfSpaces, half_spaces, outer_hull
from tossid.objects.linked_shapes import contacts_alone, find_linked_shapes
from tossid.objects.polytope import NOISE, loss_of, weights_of
from tossid.objects.round_shape import support
from tossid.objects.roundness import Roundness, ball, directions, disc, ellipsoid, farthest, joined
from tossid.objects.shape_evidence import ShapeEvidence
from tossid.rotations import matrix_to_quat, quat_to_matrix
from tossid.types import PoseTrack, Toss

Array = NDArray[np.float64]

WEDGE = 0.05 * np.array([[x, y, z] for x in (-1, 1) for y, z in ((-1, -0.6), (1, -0.6), (-1, 0.8))])

OFFSET = np.array([0.02, -0.01, 0.03])
"""Where the wedge is in its body's frame."""

TRUE = WEDGE + OFFSET

WAYS = directions(1500)


def rolled(corners: Array, rng: np.random.Generator, *, tosses: int = 12, noise: float = 2e-4) -> list[Toss]:
    """Poses of a body that flies in every second frame, and touches the ground in the others."""
    found = []
    for number in range(tosses):
        R = Rotation.random(40, rng=rng).as_matrix()
        lowest = (R @ corners.T)[:, 2].min(axis=1)
        height = np.where(np.arange(40) % 2, 0.0, rng.uniform(0.01, 0.2, 40)) - lowest + noise * rng.normal(size=40)
        q = np.column_stack([rng.uniform(-0.5, 0.5, (40, 2)), height, matrix_to_quat(R)])
        found.append(toss_of(f"{number}", q))
    return found


def distance(one: Array, other: Array) -> Array:
    return np.linalg.norm(one[:, None] - other[None], axis=-1)


def hausdorff(one: Array, other: Array) -> float:
    between = distance(one, other)
    return float(max(between.min(axis=0).max(), between.min(axis=1).max()))


@pytest.fixture(scope="module")
def wedge() -> list[Toss]:
    return rolled(TRUE, np.random.default_rng(0))


def test_half_spaces_and_their_hull_hold_the_object(wedge: list[Toss]) -> None:
    spaces = half_spaces(wedge)
    assert (spaces.height - (spaces.down @ TRUE.T).max(axis=1) > -1.5e-3).all()
    spaces = half_spaces(rolled(WEDGE, np.random.default_rng(1), noise=0.0))
    center, radius, vertices = outer_hull(spaces)
    assert 0.01 < radius < np.linalg.norm(vertices - center, axis=1).min()
    assert (spaces.down @ WEDGE.T <= spaces.height[:, None] + 1e-9).all()


def test_half_spaces_that_bound_nothing_are_refused(wedge: list[Toss]) -> None:
    down, none = np.array([[0, 0, -1.0], [0, 0, 1.0]]), np.zeros(2, dtype=np.int64)
    with pytest.raises(InputError, match="no shape fits"):
        outer_hull(HalfSpaces(down, np.array([-0.1, -0.1]), np.zeros((2, 2)), none, none.astype(bool)))
    still = toss_of("still", np.repeat(wedge[0].q[1:2], 40, axis=0))
    for find in (find_shape, ShapeEvidence):
        with pytest.raises(InputError, match="too few sides"):
            find([still])


def test_weights_have_the_gradient_of_the_loss() -> None:
    gap, free, step = np.array([-2e-3, -1e-4, 2e-4, 3e-3]), np.zeros(4, dtype=bool), 1e-8
    ahead, behind = (loss_of(gap + sign * step, free, 1e-3) for sign in (1, -1))
    slope = 2 * gap * weights_of(gap, free, 1e-3) / NOISE**2
    assert (ahead - behind) / (2 * step) == pytest.approx(slope, rel=1e-5)
    # a frame in flight only bounds
    assert weights_of(np.array([1e-3, -1e-4]), ~free[:2], 1e-3).tolist() == [0.0, 1.0]


def test_every_vertex_is_found_and_no_other(wedge: list[Toss]) -> None:
    shape = find_shape(wedge)
    assert shape.kind == "polytope"
    assert shape.vertices.shape == WEDGE.shape
    assert hausdorff(shape.vertices, TRUE) < 1e-3
    assert (shape.deviation < 1e-3).all()
    assert shape.frames.sum() > 150
    assert shape.misfit < 6e-4


def test_a_ground_that_is_higher_and_tilted_is_told(wedge: list[Toss]) -> None:
    moved = [replace(toss, q=toss.q + np.outer(1.5e-3 + 2e-3 * toss.q[:, 0], np.eye(7)[2])) for toss in wedge]
    ground = find_shape(moved).ground
    assert ground[0] == pytest.approx(1.5e-3, abs=4e-4)
    assert ground[1] == pytest.approx(2e-3, abs=8e-4)


def test_moments_are_those_of_a_box() -> None:
    half = np.array([0.03, 0.05, 0.07])
    box = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    shape = find_shape(rolled(box + OFFSET, np.random.default_rng(2), noise=0.0))
    volume, com, inertia = shape.solid()
    assert volume == pytest.approx(8 * half.prod(), rel=0.02)
    assert com == pytest.approx(OFFSET, abs=5e-4)
    assert np.diag(inertia) == pytest.approx((half[[1, 2, 0]] ** 2 + half[[2, 0, 1]] ** 2) / 3, rel=0.03)
    assert shape.mean_width == pytest.approx(half.sum(), rel=0.02)  # of a box: half the sum of its edges


def test_what_no_contact_shows_is_marked() -> None:
    tip, kept = WEDGE[2], []
    for toss in rolled(WEDGE, np.random.default_rng(3), tosses=40):
        lowest = (quat_to_matrix(toss.q[:, 3:7]) @ WEDGE.T)[:, 2].argmin(axis=1)
        kept.append(toss_of(toss.name, toss.q[lowest != 2]))
    shape = find_shape(kept)
    nearest = distance(shape.vertices, tip[None]).min()
    assert nearest > 5e-3
    assert distance(shape.unseen, tip[None]).min() < nearest


def test_too_few_contacts_show_no_shape(wedge: list[Toss]) -> None:
    flying = [np.arange(len(toss)) % 2 == 0 for toss in wedge]
    flying[1:] = [np.ones(len(toss), dtype=bool) for toss in wedge[1:]]
    with pytest.raises(InputError, match="contacts with the ground in 12 tosses"):
        find_shape(wedge, flying=flying)


OFF = np.array([0.01, -0.02, 0.005])

SHAPES = {
    "ellipsoid": (OFF[None], ellipsoid([0.06, 0.045, 0.035])),
    "sphere": (OFF[None], ball(0.04)),
    "capsule": (OFF + np.array([[0, 0, -0.03], [0, 0, 0.03]]), joined([ball(0.02)] * 2)),
    "rounded disc": (np.tile(OFF, (3, 1)), disc(0.04, [0.2, 0.1, 1.0], edge=0.01)),
}


@pytest.mark.parametrize("kind", SHAPES)
def test_a_round_shape_is_found_as_what_it_is(kind: str) -> None:
    points = farthest(*SHAPES[kind], WAYS).reshape(-1, 3)
    shape = find_shape(rolled(points, np.random.default_rng(0), tosses=16))
    assert shape.kind in (kind, "rounded cylinder") if kind == "rounded disc" else shape.kind == kind
    assert np.abs(shape.reach(WAYS) - support(*SHAPES[kind], WAYS)).max() < 5e-4
    assert 0.6 < (shape.frames >= 1).mean() < 1.0  # 320 contacts do not show every side
    assert shape.mean_width == pytest.approx(2 * support(*SHAPES[kind], WAYS).mean(), abs=5e-4)


def test_numbers_that_a_sphere_does_not_need_cost_what_its_contacts_make_them_cost() -> None:
    """A polytope shows hardly a contact of a sphere. Priced by its contacts, other shapes won in two of four draws."""
    points = farthest(*SHAPES["sphere"], WAYS)[:, 0]
    kinds = {find_shape(rolled(points, np.random.default_rng(seed), tosses=16)).kind for seed in range(1, 4)}
    assert kinds == {"sphere"}


def test_moments_of_a_round_shape_are_those_of_the_filled_one() -> None:
    shape = find_shape(rolled(farthest(*SHAPES["ellipsoid"], WAYS)[:, 0], np.random.default_rng(1), tosses=16))
    _, com, inertia = shape.solid()
    a, b, c = np.array([0.06, 0.045, 0.035]) ** 2
    assert com == pytest.approx(OFF, abs=3e-4)
    assert np.diag(inertia) == pytest.approx(np.array([b + c, a + c, a + b]) / 5, rel=0.03)
    assert isinstance(shape.roundness, Roundness)


AXES = (np.array([0.0, 1.0, 0.0]), np.array([0.0, 1.0, 0.0]))


@pytest.fixture(scope="module")
def links(elbow: ObjectModel) -> list[list[PoseTrack]]:
    return body_tracks(elbow, tosses(elbow, 40, seed=3, frames=90, substeps=2))


@pytest.fixture(scope="module")
def shapes(links: list[list[PoseTrack]]) -> tuple[ConvexShape, ...]:
    return find_linked_shapes(links, AXES)


def test_every_corner_of_each_link_is_where_it_is(shapes: tuple[ConvexShape, ...], elbow: ObjectModel) -> None:
    for body, shape in enumerate(shapes):
        between = distance(elbow.corner_pos[elbow.corner_body == body], shape.vertices)
        assert shape.vertices.shape == (8, 3)
        assert between[:, shape.frames > 0].min(axis=0).max() < 1e-3
        assert between.min(axis=1).max() < 5e-3


def test_corners_at_the_hinge_that_never_touch_are_said_to_have_no_contact(
    shapes: tuple[ConvexShape, ...], links: list[list[PoseTrack]]
) -> None:
    """They face the other link, nearer to the hinge than what touches."""
    for shape, counts, sign in zip(shapes, contacts_alone(links, shapes), (1, -1), strict=True):
        never = shape.frames == 0
        assert np.isinf(shape.deviation[never]).all()
        assert (counts[~never] > 0).all()
        assert (sign * shape.vertices[never, 1] > 0).all()
    assert sum((shape.frames == 0).sum() for shape in shapes) > 0


@pytest.fixture(scope="module")
def evidence() -> ShapeEvidence:
    return ShapeEvidence(rolled(TRUE, np.random.default_rng(1)))


def with_corner(which: int, place: Array) -> Array:
    corners = TRUE.copy()
    corners[which] = place
    return corners


def test_the_true_corners_are_not_contradicted(evidence: ShapeEvidence) -> None:
    assert evidence.unexplained(TRUE) == 0.0
    for corners in (TRUE, np.vstack([TRUE, OFFSET])):  # an inner corner beside all others is left alone
        assert evidence.contradiction(corners) is None
        np.testing.assert_allclose(evidence.corrected(corners), corners, atol=2e-3)


def test_a_corner_inside_is_missed_and_put_back(evidence: ShapeEvidence) -> None:
    wrong = with_corner(2, OFFSET)
    assert "outside the learned ones" in (evidence.contradiction(wrong) or "")
    np.testing.assert_allclose(evidence.corrected(wrong), TRUE, atol=2e-3)
    # of two in one place one is moved
    assert distance(TRUE, evidence.corrected(with_corner(0, TRUE[1] + 1e-4))).min(axis=1).max() < 2e-3


def test_every_corner_goes_where_contacts_show_it(evidence: ShapeEvidence) -> None:
    near, far = TRUE + 1e-3, with_corner(2, OFFSET)
    np.testing.assert_array_equal(evidence.corrected(near), evidence.corrected(far))


def test_a_corner_below_the_ground_is_brought_back(evidence: ShapeEvidence) -> None:
    beyond = np.vstack([TRUE, OFFSET + np.array([0.2, 0.0, 0.0])])
    assert evidence.outside(beyond).tolist() == [False] * 6 + [True]
    assert "below the ground" in (evidence.contradiction(beyond) or "")
    corrected = evidence.corrected(beyond)
    assert evidence.contradiction(corrected) is None
    np.testing.assert_allclose(corrected[:6], TRUE, atol=2e-3)
