"""One camera: pinhole with radial-tangential or equidistant distortion, at a known pose.

Camera frame: x right, y down, z forward. Pixels: (column, row), pixel centres
at integers, as OpenCV has it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

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
        X, Y, Z = points[..., 0], points[..., 1], points[..., 2]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            if self.distortion_model == EQUIDISTANT:
                d, Jd, seen = self._equidistant(X, Y, Z)
            else:
                d, Jd, seen = self._brown(X, Y, Z)
        f = self.intrinsics[:2]
        pixels = np.where(seen[..., None], f * d + self.intrinsics[2:], np.nan)
        return pixels, np.where(seen[..., None, None], f[:, None] * Jd, np.nan)

    def _brown(self, X: Array, Y: Array, Z: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        k1, k2, p1, p2, k3 = self._radtan
        x, y = X / Z, Y / Z
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = k1 + r2 * (2 * k2 + 3 * r2 * k3)  # d radial / d r²
        d = np.stack(
            [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y],
            axis=-1,
        )
        xx = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
        xy = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
        yy = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
        J = np.stack(
            [
                np.stack([xx, xy, -(xx * x + xy * y)], axis=-1) / Z[..., None],
                np.stack([xy, yy, -(xy * x + yy * y)], axis=-1) / Z[..., None],
            ],
            axis=-2,
        )
        return d, J, (Z > 0) & (r2 < self.radius_limit**2)

    def _equidistant(self, X: Array, Y: Array, Z: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        k1, k2, k3, k4 = self.distortion
        R = np.hypot(X, Y)
        theta = np.arctan2(R, Z)
        t2 = theta * theta
        theta_d = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
        slope = 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))  # d θ_d / d θ
        axis = 1e-9 * np.abs(Z) > R
        safe = np.where(axis, 1.0, R)
        scale = np.where(axis, 1.0 / Z, theta_d / safe)
        norm2 = R * R + Z * Z
        # d(θ_d / R)/dR at fixed Z, and dθ_d/dZ over R
        d_scale_R = np.where(axis, 0.0, (slope * Z / norm2 - theta_d / safe) / safe)
        d_scale_Z = np.where(axis, -1.0 / Z**2, -slope / norm2)
        cx, cy = np.where(axis, 0.0, X / safe), np.where(axis, 0.0, Y / safe)
        J = np.stack(
            [
                np.stack([scale + X * d_scale_R * cx, X * d_scale_R * cy, X * d_scale_Z], axis=-1),
                np.stack([Y * d_scale_R * cx, scale + Y * d_scale_R * cy, Y * d_scale_Z], axis=-1),
            ],
            axis=-2,
        )
        return np.stack([scale * X, scale * Y], axis=-1), J, (theta < self.radius_limit) & (norm2 > 0)

    def project(self, points_world: ArrayLike) -> Array:
        """World points [m] (*b, n, 3) to pixels (*b, n, 2); NaN where not in front of the lens."""
        return self.distort(transform_points(self.T_cam_world, points_world))[0]

    def undistort(self, pixels: ArrayLike) -> Array:
        """Pixels (*b, 2) to normalised image coordinates (x, y) = (X/Z, Y/Z), to 1e-10.

        Newton's method on `distort`. NaN where it does not converge.
        """
        pixels = np.asarray(pixels, dtype=float)
        f, c = self.intrinsics[:2], self.intrinsics[2:]
        target = (pixels - c) / f
        if self.distortion_model == EQUIDISTANT:
            return self._undistort_equidistant(target)
        return undistort_brown(target.reshape(-1, 2), self._radtan, self.radius_limit).reshape(target.shape)

    def _undistort_equidistant(self, target: Array) -> Array:
        k1, k2, k3, k4 = self.distortion
        theta_d = np.linalg.norm(target, axis=-1)
        theta = np.minimum(theta_d, 0.9 * self.radius_limit)
        error = np.zeros_like(theta)
        for _ in range(20):
            t2 = theta * theta
            error = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))) - theta_d
            theta = theta - error / (1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4))))
            if not (np.abs(error) > 1e-13).any():
                break
        scale = np.where(theta_d > 1e-12, np.tan(theta) / np.where(theta_d > 1e-12, theta_d, 1.0), 1.0)
        good = (np.abs(error) < 1e-10) & (theta >= 0) & (theta < min(self.radius_limit, np.pi / 2))
        return np.where(good[..., None], target * scale[..., None], np.nan)

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
