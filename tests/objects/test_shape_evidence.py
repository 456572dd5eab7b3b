"""Corners that frames contradict, and where frames show corners instead."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from tests.objects.test_convex_shape import OFFSET, WEDGE, rolled
from tossid.errors import InputError
from tossid.objects import shape_evidence
from tossid.objects.convex_shape import ConvexShape, find_shape
from tossid.objects.shape_evidence import ShapeEvidence
from tossid.settings.objects import ShapeSettings
from tossid.types import Toss

TRUE = WEDGE + OFFSET


@pytest.fixture(scope="module")
def evidence() -> ShapeEvidence:
    return ShapeEvidence(rolled(TRUE, np.random.default_rng(1)))


def test_the_true_corners_are_not_contradicted(evidence: ShapeEvidence) -> None:
    assert evidence.unexplained(TRUE) == 0.0
    assert evidence.contradiction(TRUE) is None


def test_a_corner_inside_is_missed_and_put_back(evidence: ShapeEvidence) -> None:
    wrong = TRUE.copy()
    wrong[2] = OFFSET
    assert "outside the learned ones" in (evidence.contradiction(wrong) or "")
    corrected = evidence.corrected(wrong)
    np.testing.assert_array_equal(np.delete(corrected, 2, axis=0), np.delete(TRUE, 2, axis=0))
    assert np.linalg.norm(corrected[2] - TRUE[2]) < 2e-3


def test_every_corner_goes_where_contacts_show_it(evidence: ShapeEvidence) -> None:
    near, far = TRUE + 1e-3, TRUE.copy()
    far[2] = OFFSET
    np.testing.assert_array_equal(evidence.corrected(near), near)
    np.testing.assert_array_equal(evidence.corrected(near, every=True), evidence.corrected(far, every=True))


def test_two_corners_in_one_place_are_parted(evidence: ShapeEvidence) -> None:
    wrong = TRUE.copy()
    wrong[0] = wrong[1] + 1e-4
    corrected = evidence.corrected(wrong)
    distance = np.linalg.norm(TRUE[:, None] - corrected[None], axis=-1)
    assert distance.min(axis=1).max() < 2e-3


def test_a_corner_below_the_ground_is_brought_back(evidence: ShapeEvidence) -> None:
    beyond = np.vstack([TRUE, OFFSET + np.array([0.2, 0.0, 0.0])])
    assert evidence.outside(beyond).tolist() == [False] * 6 + [True]
    assert "below the ground" in (evidence.contradiction(beyond) or "")
    corrected = evidence.corrected(beyond)
    assert evidence.contradiction(corrected) is None
    np.testing.assert_array_equal(corrected[:6], TRUE)


def test_an_inner_corner_beside_all_others_is_left_alone(evidence: ShapeEvidence) -> None:
    more = np.vstack([TRUE, OFFSET])
    assert evidence.contradiction(more) is None
    np.testing.assert_array_equal(evidence.corrected(more), more)


def test_too_few_sides_are_refused() -> None:
    flat = rolled(TRUE, np.random.default_rng(1), tosses=1)[0].frames(slice(0, 2))
    with pytest.raises(InputError, match="too few sides"):
        ShapeEvidence([flat])


def test_the_same_poses_are_searched_once(monkeypatch: pytest.MonkeyPatch) -> None:
    searched: list[int] = []

    def counted(tosses: Sequence[Toss], settings: ShapeSettings) -> ConvexShape:
        searched.append(len(tosses))
        return find_shape(tosses, settings)

    monkeypatch.setattr(shape_evidence, "find_shape", counted)
    tosses = rolled(TRUE, np.random.default_rng(7))
    again = [replace(toss, q=toss.q.copy()) for toss in tosses]
    one, other, fewer = (ShapeEvidence(each).shape for each in (tosses, again, tosses[1:]))
    assert searched == [len(tosses), len(tosses) - 1]
    np.testing.assert_array_equal(one.vertices, other.vertices)
    assert not np.array_equal(one.vertices, fewer.vertices)
    ShapeEvidence(tosses, find=ShapeSettings(noise=4e-4)).shape  # noqa: B018
    assert searched[-1] == len(tosses)
