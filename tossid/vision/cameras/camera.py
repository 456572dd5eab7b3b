"""One camera: pinhole with radial-tangential or equidistant distortion, at a known pose.

Camera frame: x right, y down, z forward. Pixels: (column, row), pixel centres
at integers, as OpenCV has it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tossid.errors import InputError
from tossid.rotations import transform_inv, transform_points
from tossid.vision.cameras._undistort import undistort_brown

Array = NDArray[np.float64]

EQUIDISTANT = "equidistant"
DISTORTION_MODELS = {"radtan": (4, 5), "plumb_bob": (4, 5), "none": (0, 4, 5), EQUIDISTANT: (4,)}
"""How many coefficients each model can have; those of "none" are zeros."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A calibrated camera.

    Attributes:
        name: Its name, as in `cameras.yaml`.
        resolution: (width, height) [px].
        intrinsics: (fx, fy, cx, cy) [px].
        distortion_model: "radtan" (or "plumb_bob", the same; "none" for zeros) or "equidistant".
        distortion: radtan (k1, k2, p1, p2[, k3]); equidistant (k1, k2, k3, k4).
        T_rig_cam: (4, 4) pose on the rig, None if unknown.
        T_world_rig: (4, 4) pose of the rig, None if unknown or moving.
        rig_body: name of the rig in `tagslam.yaml`.
        rate_hz: frames a second, None if unknown.
        T_rig_cam_cov: (6, 6) covariance of T_rig_cam (rotation [rad²], translation [m²], in the camera's frame),
            None for exact.
        wiggle: Standard deviations (rotation [rad], translation [m]) of the pose on the rig from frame to frame;
            None for a rigid mount.
        clock_offset: How late its time stamps are [s]; it is subtracted where frames are read.
        image_topic, tag_topic: where a bag has its images and its detections.
    """

    name: str
    resolution: tuple[int, int]
    intrinsics: Array
    distortion_model: str = "radtan"
    distortion: Array = field(default_factory=lambda: np.zeros(4))
    T_rig_cam: Array | None = field(default_factory=lambda: np.eye(4))
    T_world_rig: Array | None = field(default_factory=lambda: np.eye(4))
    rig_body: str = "rig"
    rate_hz: float | None = None
    T_rig_cam_cov: Array | None = None
    wiggle: tuple[float, float] | None = None
    clock_offset: float = 0.0
    image_topic: str = ""
    tag_topic: str = ""

    def __post_init__(self) -> None:
        """Refuse values that no camera can have."""
        object.__setattr__(self, "intrinsics", np.asarray(self.intrinsics, dtype=float))
        object.__setattr__(self, "distortion", np.asarray(self.distortion, dtype=float))
        if self.intrinsics.shape != (4,) or not np.isfinite(self.intrinsics).all() or (self.intrinsics[:2] <= 0).any():
            raise InputError(f"camera '{self.name}': intrinsics must be (fx, fy, cx, cy) with positive fx, fy")
        if self.distortion_model not in DISTORTION_MODELS:
            known = ", ".join(DISTORTION_MODELS)
            raise InputError(f"camera '{self.name}': distortion model '{self.distortion_model}' is not one of {known}")
        counts = DISTORTION_MODELS[self.distortion_model]
        if self.distortion.ndim != 1 or len(self.distortion) not in counts or not np.isfinite(self.distortion).all():
            raise InputError(
                f"camera '{self.name}': {self.distortion_model} takes {' or '.join(map(str, counts))} "
                f"finite distortion coefficients, got {self.distortion.tolist()}"
            )
        if self.distortion_model == "none" and self.distortion.any():
            raise InputError(
                f"camera '{self.name}': distortion model 'none' has coefficients {self.distortion.tolist()}"
            )
        if not np.isfinite(self.clock_offset):
            raise InputError(f"camera '{self.name}': clock_offset is {self.clock_offset}, expected seconds")
        if len(self.resolution) != 2 or min(self.resolution) < 1:
            raise InputError(f"camera '{self.name}': resolution must be (width, height), got {self.resolution}")

    @property
    def T_world_cam(self) -> Array:
        """(4, 4) pose in the world. `InputError` where the rig or the camera on it is not placed."""
        if self.T_rig_cam is None or self.T_world_rig is None:
            raise InputError(f"camera '{self.name}' has no known pose in the world (its rig is '{self.rig_body}')")
        return self.T_world_rig @ self.T_rig_cam

    @cached_property
    def T_cam_world(self) -> Array:
        """Inverse of `T_world_cam`. (4, 4)."""
        return transform_inv(self.T_world_cam)

    @property
    def matrix(self) -> Array:
        """OpenCV's camera matrix K. (3, 3)."""
        fx, fy, cx, cy = self.intrinsics
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @cached_property
    def _radtan(self) -> tuple[float, float, float, float, float]:
        """k1, k2, p1, p2, k3."""
        k1, k2, p1, p2, k3 = np.concatenate([self.distortion, np.zeros(5 - len(self.distortion))]).tolist()
        return k1, k2, p1, p2, k3

    @cached_property
    def radius_limit(self) -> float:
        """Largest normalised radius (angle [rad] if equidistant) at which distortion is still one to one."""
        if self.distortion_model == EQUIDISTANT:
            slope = np.array([1.0, *(self.distortion * np.array([3.0, 5.0, 7.0, 9.0]))])
        else:
            k1, k2, _, _, k3 = self._radtan
            slope = np.array([1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3])
        roots = np.polynomial.Polynomial(slope).roots()
        real = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)]
        limit = float(np.sqrt(real.min())) if len(real) else np.inf
        return min(limit, np.pi) if self.distortion_model == EQUIDISTANT else limit

    def distort(self, points: ArrayLike) -> tuple[Array, Array]:
        """Camera-frame points to pixels.

        radtan: Brown 1966 as OpenCV has it. equidistant: Kannala and Brandt
        2006, θ_d = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸), as Kalibr has it.

        Args:
            points: (*b, 3) [m] in the camera frame.

        Returns:
            pixels (*b, 2) and their Jacobian d pixel / d point (*b, 2, 3). NaN for
            points behind the camera or outside the range of the lens model.
        """
        points = np.asarray(points, dtype=float)
        if not points.size:
            return np.zeros((*points.shape[:-1], 2)), np.zeros((*points.shape[:-1], 2, 3))
        flat, still = points.reshape(-1, 1, 3), np.zeros(3)
        Z, radius = flat[:, 0, 2], np.linalg.norm(flat[:, 0, :2], axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = np.arctan2(radius, Z) if self.distortion_model == EQUIDISTANT else radius / Z
        seen = (Z > 0) & (reach < self.radius_limit)
        safe = np.where(seen[:, None, None], flat, [0.0, 0.0, 1.0])
        # the derivative by a translation is that by the point
        if self.distortion_model == EQUIDISTANT:
            pixels, J = cv2.fisheye.projectPoints(safe, still, still, self.matrix, self.distortion)
            by_point = J[:, 11:14]
        else:
            pixels, J = cv2.projectPoints(safe, still, still, self.matrix, np.array(self._radtan))
            by_point = J[:, 3:6]
        pixels[~seen], by_point[np.repeat(~seen, 2)] = np.nan, np.nan
        shape = points.shape[:-1]
        return np.asarray(pixels, dtype=float).reshape(*shape, 2), np.asarray(by_point, float).reshape(*shape, 2, 3)

    def project(self, points_world: ArrayLike) -> Array:
        """World points [m] (*b, n, 3) to pixels (*b, n, 2); NaN where not in front of the lens."""
        return self.distort(transform_points(self.T_cam_world, points_world))[0]

    def undistort(self, pixels: ArrayLike) -> Array:
        """Pixels (*b, 2) to normalised image coordinates (x, y) = (X/Z, Y/Z), to 1e-10.

        Newton's method on `distort`. NaN where it does not converge.
        """
        pixels = np.asarray(pixels, dtype=float)
        if self.distortion_model != EQUIDISTANT or not pixels.size:
            target = (pixels - self.intrinsics[2:]) / self.intrinsics[:2]
            return undistort_brown(target.reshape(-1, 2), self._radtan, self.radius_limit).reshape(target.shape)
        exact = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-14)
        flat = np.where(np.isfinite(pixels), pixels, -1e6).reshape(-1, 1, 2)
        xy = cv2.fisheye.undistortPoints(flat, self.matrix, self.distortion, criteria=exact).reshape(pixels.shape)
        again = self.distort(np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1))[0]
        good = np.abs(again - pixels).max(axis=-1) < 1e-10 * self.intrinsics[:2].max()
        return np.where(good[..., None], xy, np.nan)

    @cached_property
    def rays(self) -> Array:
        """Normalised coordinates at the pixels' corners (height + 1, width + 1, 2).

        [row, column] is pixel position (column - 0.5, row - 0.5). Bilinear interpolation in between is good to about
        1e-4 px for ordinary lenses.
        """
        width, height = self.resolution
        u, v = np.meshgrid(np.arange(width + 1) - 0.5, np.arange(height + 1) - 0.5)
        return np.ascontiguousarray(self.undistort(np.stack([u, v], axis=-1)))

    def contains(self, pixels: ArrayLike, *, margin: float = 0.0) -> NDArray[np.bool_]:
        """Whether pixels (*b, 2) lie in the image, `margin` [px] from its edge. NaN: no."""
        pixels = np.asarray(pixels, dtype=float)
        high = np.asarray(self.resolution, dtype=float) - 1 - margin
        return np.asarray(((pixels >= margin) & (pixels <= high)).all(axis=-1))
