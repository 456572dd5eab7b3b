"""Where in a camera's next image an object must be, by the poses of its bodies in the last ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.objects import ObjectModel, body_poses
from tossid.rotations import quat_rotate, transform_inv, transform_points
from tossid.types import Detection
from tossid.vision.cameras.camera import Camera
from tossid.vision.detection.corners import rays_at
from tossid.vision.pose_graph.resect import tag_poses
from tossid.vision.setup.faces import tag_corners
from tossid.vision.setup.layout import SQUARE

Array = NDArray[np.float64]

VELOCITY_CHANGE = 1.0
"""A body's velocity may change by as much as it is, and by this much more, from frame to frame [m/s]: at an impact."""
MARGIN = 8.0
"""Margin around a tag, for its white border and blur [px]."""
RMS_RATIO, RMS_SLACK = 3.0, 0.3
"""Poses whose rms reprojection is less than this times the best one's, and this much more [px], are possible."""


@dataclass(frozen=True, eq=False)
class _Seen:
    """A body in one image: its possible centres (k, 3) [m], the likeliest first, and velocity (3,), camera frame."""

    t: float
    centers: Array
    velocity: Array


class Predictor:
    """The place of an object in one camera's images, followed from pose to pose.

    The tags of a body give its pose in the camera's frame, or two poses where there is only one tag. The body's
    middle is predicted to move on at its velocity; the tags lie within a sphere about it, however it turns.
    """

    def __init__(self, camera: Camera, model: ObjectModel) -> None:
        """Predict for one camera."""
        self.camera = camera
        self._tags = {tag.id: tag for tag in model.tags}
        self._middle, self._own, self._all = tag_spheres(model)
        self._tagged = np.flatnonzero(np.isfinite(self._own))
        self._last: dict[int, _Seen] = {}
        self._before: dict[int, _Seen] = {}  # in an earlier image than the last

    def forget(self) -> None:
        """The object is lost."""
        self._last, self._before = {}, {}

    def box(self, t: float) -> tuple[int, int, int, int] | None:
        """Columns and rows [x0, x1) x [y0, y1) that hold all of the object's tags at a time [s].

        None where nothing is known, or the object is out of view.
        """
        low, high = np.full(2, np.inf), np.full(2, -np.inf)
        complete = all(body in self._last for body in self._tagged)
        for body, seen in self._last.items():
            dt = t - seen.t
            radius = (self._own if complete else self._all)[body]
            radius += abs(dt) * (float(np.linalg.norm(seen.velocity)) + VELOCITY_CHANGE) if dt else 0.0
            centers = seen.centers + dt * seen.velocity
            pixels, _ = self.camera.distort(centers)
            depth = centers[:, 2] - radius
            if not np.isfinite(pixels).all() or (depth <= 0).any():
                return None
            reach = (self.camera.intrinsics[:2].max() * radius / depth)[:, None] + MARGIN
            low, high = np.minimum(low, (pixels - reach).min(axis=0)), np.maximum(high, (pixels + reach).max(axis=0))
        low, high = np.maximum(np.floor(low), 0), np.minimum(np.ceil(high) + 1, self.camera.resolution)
        if not (high - low >= 16).all():
            return None
        return int(low[0]), int(low[1]), int(high[0]), int(high[1])

    def see(self, t: float, found: Sequence[Detection]) -> None:
        """Take in what was seen at a time [s]."""
        if any(seen.t < t for seen in self._last.values()):
            self._before = self._last
        self._last = {}
        for body in self._tagged:
            own = [d for d in found if self._tags[d.tag_id].body == body]
            centers = self._centers(own, self._middle[body]) if own else None
            if centers is None:
                continue
            velocity, earlier = np.zeros(3), self._before.get(int(body))
            if earlier is not None:
                # of what is possible, the least motion; the likeliest place then is where that ends
                way = centers[:, None] - earlier.centers
                size = np.linalg.norm(way, axis=-1)
                i, k = np.unravel_index(np.argmin(size), size.shape)
                velocity = way[i, k] / (t - earlier.t)
            self._last[int(body)] = _Seen(t, centers, velocity)

    def _centers(self, found: Sequence[Detection], middle: Array) -> Array | None:
        """The middle of a body in every pose that fits all of its tags (k, 3) [m], best first."""
        tags = [self._tags[d.tag_id] for d in found]
        half = np.array([0.5 * tag.size for tag in tags])
        seen = rays_at(self.camera.rays, np.stack([d.corners for d in found]))
        T_body_tag = np.stack([tag.T_body_tag for tag in tags])
        T = (tag_poses(seen, half) @ transform_inv(T_body_tag)[:, None]).reshape(-1, 4, 4)
        T = T[np.isfinite(T[:, 0, 0])]
        if not len(T):
            return None
        points = transform_points(T_body_tag, half[:, None, None] * SQUARE).reshape(-1, 3)
        x = transform_points(T, points)
        with np.errstate(divide="ignore", invalid="ignore"):
            flat = x[..., :2] / np.where(x[..., 2:] > 0, x[..., 2:], np.nan) - seen.reshape(-1, 2)
        rms = self.camera.intrinsics[0] * np.sqrt(np.nan_to_num(np.sum(flat**2, axis=-1), nan=np.inf).mean(axis=-1))
        order = np.argsort(rms)
        order = order[rms[order] <= RMS_RATIO * rms[order[0]] + RMS_SLACK]
        return np.asarray(transform_points(T[order], middle[None])[:, 0])


def tag_spheres(model: ObjectModel) -> tuple[Array, Array, Array]:
    """For each body, spheres that hold tags; joints are taken at eight angles.

    Returns:
        The middle of each body's own tags, in its frame (n_b, 3) [m]; the radii about it that hold its own tags (n_b,)
        and all of the object's (n_b,) [m]. NaN for bodies without tags.
    """
    corners = [
        np.concatenate([tag_corners(tag) for tag in model.tags if tag.body == b] or [np.zeros((0, 3))])
        for b in range(model.n_bodies)
    ]
    middle, own, whole = np.full((model.n_bodies, 3), np.nan), np.full(model.n_bodies, np.nan), np.zeros(model.n_bodies)
    for b, points in enumerate(corners):
        if len(points):
            middle[b] = points.mean(axis=0)
            own[b] = np.linalg.norm(points - middle[b], axis=1).max()
    for angle in np.linspace(0, 2 * np.pi, 8, endpoint=False) if model.n_joints else (0.0,):
        q = np.zeros(model.nq)
        q[3], q[7:] = 1.0, angle
        position, quat = body_poses(model, q)
        world = np.concatenate([position[b] + quat_rotate(quat[b], points) for b, points in enumerate(corners)])
        for b in range(model.n_bodies):
            center = position[b] + quat_rotate(quat[b], middle[b])
            whole[b] = np.maximum(whole[b], np.linalg.norm(world - center, axis=1).max())
    return middle, own, whole
