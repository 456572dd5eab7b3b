"""Where in a camera's next image an object must be, by the tags that were seen in the last ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tossid.objects import ObjectModel, body_poses
from tossid.rotations import quat_rotate
from tossid.types import Detection
from tossid.vision.cameras.camera import Camera
from tossid.vision.setup.faces import tag_corners

Array = NDArray[np.float64]

VELOCITY_CHANGE = 1.0
"""From frame to frame, at an impact, a velocity may change by as much as it is, and by this much more [m/s]."""
MARGIN = 8.0
"""Margin around a tag, for its white border and blur [px]."""
NEAREST = 0.2
"""Least depth of the object's nearest tag, as a share of that of a tag that is seen."""


class Predictor:
    """The place of an object in one camera's images, followed from image to image.

    All of the object's tags lie within a sphere about each tag that is seen. Its radius in pixels follows from the
    tag's size. The spheres of several tags are intersected, and move on as the tags moved.
    """

    def __init__(self, camera: Camera, model: ObjectModel) -> None:
        """Predict for one camera."""
        self.camera = camera
        self._size = {tag.id: tag.size for tag in model.tags}
        self._reach = tag_reaches(model)
        self.forget()

    def forget(self) -> None:
        """The object is lost."""
        self._t = np.nan
        self._middle: dict[int, Array] = {}  # of each tag seen [px]
        self._scale = 0.0  # pixels a metre
        self._velocity = np.zeros(2)  # [px/s]

    def box(self, t: float) -> tuple[int, int, int, int] | None:
        """Columns and rows [x0, x1) x [y0, y1) that hold all of the object's tags at a time [s].

        None where nothing is known, or the object is out of view.
        """
        if not self._middle:
            return None
        dt = t - self._t
        reach = self._scale * np.array([self._reach[tag_id] for tag_id in self._middle])[:, None]
        # what is nearer to the camera than the tag looks larger
        reach /= np.maximum(1 - reach / self.camera.intrinsics[:2].max(), NEAREST)
        grown = MARGIN + abs(dt) * (np.linalg.norm(self._velocity) + VELOCITY_CHANGE * self._scale)
        middle = np.stack(list(self._middle.values())) + dt * self._velocity
        low, high = (middle - reach).max(axis=0) - grown, (middle + reach).min(axis=0) + grown
        low, high = np.maximum(np.floor(low), 0), np.minimum(np.ceil(high) + 1, self.camera.resolution)
        if not (high - low >= 16).all():
            return None
        return int(low[0]), int(low[1]), int(high[0]), int(high[1])

    def see(self, t: float, found: Sequence[Detection]) -> None:
        """Take in what was seen at a time [s]."""
        middle = {d.tag_id: d.corners.mean(axis=0) for d in found}
        if t > self._t:
            moves = [middle[tag_id] - self._middle[tag_id] for tag_id in middle.keys() & self._middle.keys()]
            self._velocity = np.mean(moves, axis=0) / (t - self._t) if moves else np.zeros(2)
        sides = [np.linalg.norm(d.corners - np.roll(d.corners, 1, axis=0), axis=1).max() for d in found]
        self._scale = max(side / self._size[d.tag_id] for side, d in zip(sides, found, strict=True))
        self._t, self._middle = t, middle


def tag_reaches(model: ObjectModel) -> dict[int, float]:
    """By id, how far the farthest corner of any is from each tag's middle [m]; joints are taken at eight angles."""
    farthest = np.zeros(len(model.tags))
    for angle in np.linspace(0, 2 * np.pi, 8, endpoint=False) if model.n_joints else (0.0,):
        q = np.zeros(model.nq)
        q[3], q[7:] = 1.0, angle
        position, quat = body_poses(model, q)
        world = np.stack([position[tag.body] + quat_rotate(quat[tag.body], tag_corners(tag)) for tag in model.tags])
        apart = world.reshape(-1, 3) - world.mean(axis=1)[:, None]
        farthest = np.maximum(farthest, np.linalg.norm(apart, axis=-1).max(axis=1))
    return {tag.id: float(reach) for tag, reach in zip(model.tags, farthest, strict=True)}
