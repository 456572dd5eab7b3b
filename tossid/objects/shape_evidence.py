"""What frames say for and against the corners of a rigid body.

Every frame bounds the object by a half-space (`half_spaces`). Their intersection, the outer hull, holds the object, so
a corner far outside it is wrong. A frame whose half-space touches the outer hull is *tight*: the object was then on the
ground, or nothing else shows how far it reaches. Corners that stay well above the ground in tight frames do not explain
them: one of the object's corners is missing. At the right corners of the published cube no frame is unexplained, with
8 tosses or with 250; with one corner of eight inside the body 0.3 to 3 % of the tight frames are.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from tossid.errors import InputError
from tossid.objects.convex_shape import ConvexShape, find_shape
from tossid.objects.half_spaces import HalfSpaces, different, half_spaces, outer_hull, protrusion
from tossid.settings.objects import EvidenceSettings, ShapeSettings
from tossid.types import Toss

Array = NDArray[np.float64]


class ShapeEvidence:
    """The frames of tosses of one rigid body, against which corners are held.

    Args:
        tosses: In any body frame, over the ground z = 0, with true lengths.
        settings: What counts as a contradiction.
        find: How a shape is found where corners are contradicted.
        shape: The shape that the tosses show, where it is known.

    Raises:
        InputError: The frames do not bound the object.
    """

    def __init__(
        self,
        tosses: Sequence[Toss],
        settings: EvidenceSettings | None = None,
        *,
        find: ShapeSettings | None = None,
        shape: ConvexShape | None = None,
    ) -> None:
        self.settings, self._find = settings or EvidenceSettings(), find or ShapeSettings()
        self._asked, self._shape = _Asked.of(tuple(tosses), self._find), shape
        self.radius, spaces, gap = _bounds_by(self._asked)
        self._tight = spaces.chosen(gap < self.settings.tight_rel * self.radius)

    @cached_property
    def shape(self) -> ConvexShape:
        """The shape that the tosses show.

        Raises:
            InputError: There is too little contact in them.
        """
        return _shown_by(self._asked) if self._shape is None else self._shape

    def unexplained(self, corners: Array) -> float:
        """Share of the tight frames in which all corners are well above the ground.

        Args:
            corners: (n, 3) in the body's frame [m].
        """
        gap = self._tight.height - (self._tight.down @ corners.T).max(axis=1)
        return float((gap > self.settings.missing_rel * self.radius).mean())

    def outside(self, corners: Array) -> NDArray[np.bool_]:
        """Marks corners (n,) that some frame would put well below the ground.

        Args:
            corners: (n, 3) in the body's frame [m].
        """
        depth = (corners @ self._tight.down.T - self._tight.height).max(axis=1)
        return np.asarray(depth > self.settings.outside_rel * self.radius)

    def shown(self) -> Array:
        """Corners (m, 3) that contacts show, each often and surely enough [m]; none where there is no shape."""
        try:
            shape = self.shape
        except InputError:
            return np.zeros((0, 3))
        sure = shape.deviation < self.settings.missing_rel * self.radius
        return shape.vertices[(shape.frames >= self.settings.fewest_shown) & sure]

    def missing(self, corners: Array) -> Array:
        """Shown corners (m, 3) that lie well outside the hull of corners [m].

        A shape is looked for only where corners leave tight frames unexplained.

        Args:
            corners: (n, 3) in the body's frame [m].
        """
        if self.unexplained(corners) <= self.settings.unexplained_share:
            return np.zeros((0, 3))
        shown = self.shown()
        beyond = np.array([protrusion(point, corners) for point in shown])
        return np.asarray(shown[beyond > self.settings.missing_rel * self.radius])

    def contradiction(self, corners: Array) -> str | None:
        """What is wrong with corners, in words; None where nothing is.

        Args:
            corners: (n, 3) in the body's frame [m].
        """
        missing, outside = len(self.missing(corners)), int(self.outside(corners).sum())
        found = []
        if missing:
            share, reach = self.unexplained(corners), 1e3 * self.settings.missing_rel * self.radius
            found.append(
                f"contacts show {missing} corners more than {reach:.0f} mm outside the learned ones, which leave "
                f"{100 * share:.1f} % of the frames near the ground unexplained"
            )
        if outside:
            reach = 1e3 * self.settings.outside_rel * self.radius
            found.append(f"{outside} learned corners lie more than {reach:.0f} mm below the ground in some frame")
        return "; ".join(found) or None

    def corrected(self, corners: Array, *, every: bool = False) -> Array:
        """Corners with those that are dead or outside moved to where the tosses show one.

        Shown corners and given ones are assigned to each other so that the distances add up to the least. Of a pair
        that is far apart the given one is moved. A corner without a partner stays, unless it is outside.

        Args:
            corners: (n, 3) in the body's frame [m].
            every: Whether those with a partner close by are moved, too.

        Returns:
            Corners (n, 3); as they were where the tosses show none.
        """
        shown = self.shown()
        if not len(shown):
            return corners.copy()
        distance = np.linalg.norm(corners[:, None] - shown[None], axis=-1)
        moved, (own, other) = corners.copy(), linear_sum_assignment(distance)
        far = (distance[own, other] > self.settings.missing_rel * self.radius) | every
        moved[own[far]] = shown[other[far]]
        alone = self.outside(moved)
        moved[alone] = shown[distance[alone].argmin(axis=1)]
        return moved


@dataclass(frozen=True)
class _Asked:
    """The poses in which a shape is looked for, which the digest stands for, and how."""

    digest: bytes
    settings: ShapeSettings
    tosses: tuple[Toss, ...] = field(compare=False)

    @staticmethod
    def of(tosses: tuple[Toss, ...], settings: ShapeSettings) -> _Asked:
        found = hashlib.sha256()
        for toss in tosses:
            found.update(len(toss.q).to_bytes(8, "little") + np.ascontiguousarray(toss.q).tobytes())
        return _Asked(found.digest(), settings, tosses)


@lru_cache(maxsize=4)
def _shown_by(asked: _Asked) -> ConvexShape:
    """The shape, found once for the trainings of a study, which learn from the same tosses."""
    return find_shape(asked.tosses, asked.settings)


@lru_cache(maxsize=4)
def _bounds_by(asked: _Asked) -> tuple[float, HalfSpaces, Array]:
    """How far the outer hull reaches [m], frames that differ, and their gaps to it (n,) [m]; found once as well."""
    every = half_spaces(asked.tosses)
    _, radius, outer = outer_hull(every, asked.settings)
    spaces = every.chosen(different(every, asked.settings))
    return radius, spaces, spaces.height - (spaces.down @ outer.T).max(axis=1)
