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
from tossid.types import Toss

Array = NDArray[np.float64]

_TIGHT = 0.05
"""A frame is tight when its gap to the outer hull is below this share of the radius of the largest ball inside."""
_MISSING = 0.1
"""Share of that radius by which all corners may stay above the ground in a tight frame, and by which a corner may be
off one that the tosses show."""
_OUTSIDE = 0.25
"""Share of that radius by which a corner may be below the ground in some frame; real ones sink at impacts."""
_UNEXPLAINED = 2e-3
"""Share of the tight frames that corners may leave unexplained."""
_FEWEST_SHOWN = 5
"""Different contacts that show a corner."""


class ShapeEvidence:
    """The frames of tosses of one rigid body, against which corners are held.

    Args:
        tosses: In any body frame, over the ground z = 0, with true lengths.
        shape: The shape that the tosses show, where it is known.

    Raises:
        InputError: The frames do not bound the object.
    """

    def __init__(self, tosses: Sequence[Toss], *, shape: ConvexShape | None = None) -> None:
        self._poses, self._shape = _Poses.of(tuple(tosses)), shape
        self.radius, spaces, gap = _bounds_of(self._poses)
        self._tight = spaces.chosen(gap < _TIGHT * self.radius)

    @cached_property
    def shape(self) -> ConvexShape:
        """The shape that the tosses show.

        Raises:
            InputError: There is too little contact in them.
        """
        return _shape_of(self._poses) if self._shape is None else self._shape

    def unexplained(self, corners: Array) -> float:
        """Share of the tight frames in which all corners are well above the ground.

        Args:
            corners: (n, 3) in the body's frame [m].
        """
        gap = self._tight.height - (self._tight.down @ corners.T).max(axis=1)
        return float((gap > _MISSING * self.radius).mean())

    def outside(self, corners: Array) -> NDArray[np.bool_]:
        """Marks corners (n,) that some frame would put well below the ground.

        Args:
            corners: (n, 3) in the body's frame [m].
        """
        depth = (corners @ self._tight.down.T - self._tight.height).max(axis=1)
        return np.asarray(depth > _OUTSIDE * self.radius)

    def shown(self) -> Array:
        """Corners (m, 3) that contacts show, each often and surely enough [m]; none where there is no shape."""
        try:
            shape = self.shape
        except InputError:
            return np.zeros((0, 3))
        sure = shape.deviation < _MISSING * self.radius
        return shape.vertices[(shape.frames >= _FEWEST_SHOWN) & sure]

    def missing(self, corners: Array) -> Array:
        """Shown corners (m, 3) that lie well outside the hull of corners [m].

        A shape is looked for only where corners leave tight frames unexplained.

        Args:
            corners: (n, 3) in the body's frame [m].
        """
        if self.unexplained(corners) <= _UNEXPLAINED:
            return np.zeros((0, 3))
        shown = self.shown()
        return np.asarray(shown[protrusion(shown, corners) > _MISSING * self.radius])

    def contradiction(self, corners: Array) -> str | None:
        """What is wrong with corners, in words; None where nothing is.

        Args:
            corners: (n, 3) in the body's frame [m].
        """
        missing, outside = len(self.missing(corners)), int(self.outside(corners).sum())
        found = []
        if missing:
            share, reach = self.unexplained(corners), 1e3 * _MISSING * self.radius
            found.append(
                f"contacts show {missing} corners more than {reach:.0f} mm outside the learned ones, which leave "
                f"{100 * share:.1f} % of the frames near the ground unexplained"
            )
        if outside:
            reach = 1e3 * _OUTSIDE * self.radius
            found.append(f"{outside} learned corners lie more than {reach:.0f} mm below the ground in some frame")
        return "; ".join(found) or None

    def corrected(self, corners: Array) -> Array:
        """Corners, moved to where the tosses show some.

        Shown corners and given ones are assigned to each other so that the distances add up to the least, and of a pair
        the given one is moved. A corner without a partner stays, unless some frame would put it well below the ground.

        Args:
            corners: (n, 3) in the body's frame [m].

        Returns:
            Corners (n, 3); as they were where the tosses show none.
        """
        shown = self.shown()
        if not len(shown):
            return corners.copy()
        distance = np.linalg.norm(corners[:, None] - shown[None], axis=-1)
        moved, (own, other) = corners.copy(), linear_sum_assignment(distance)
        moved[own] = shown[other]
        alone = self.outside(moved)
        moved[alone] = shown[distance[alone].argmin(axis=1)]
        return moved


@dataclass(frozen=True)
class _Poses:
    """Poses, for which their digest stands."""

    digest: bytes
    tosses: tuple[Toss, ...] = field(compare=False)

    @staticmethod
    def of(tosses: tuple[Toss, ...]) -> _Poses:
        found = hashlib.sha256()
        for toss in tosses:
            found.update(len(toss.q).to_bytes(8, "little") + np.ascontiguousarray(toss.q).tobytes())
        return _Poses(found.digest(), tosses)


@lru_cache(maxsize=4)
def _shape_of(poses: _Poses) -> ConvexShape:
    """The shape, found once for the trainings of a study, which learn from the same tosses."""
    return find_shape(poses.tosses)


@lru_cache(maxsize=4)
def _bounds_of(poses: _Poses) -> tuple[float, HalfSpaces, Array]:
    """How far the outer hull reaches [m], frames that differ, and their gaps to it (n,) [m]; found once as well."""
    every = half_spaces(poses.tosses)
    _, radius, outer = outer_hull(every)
    spaces = every.chosen(different(every))
    return radius, spaces, spaces.height - (spaces.down @ outer.T).max(axis=1)
