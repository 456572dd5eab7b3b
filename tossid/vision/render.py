"""Camera images of a moving object with tags, drawn on the CPU without OpenGL.

Perspective and lens distortion are exact (rays are cast through the camera
model), edges are antialiased and motion is blurred by sampling each pixel over
its area and the exposure; then come the lens's blur and the sensor's noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tossid.errors import InputError
from tossid.objects import ObjectModel, body_poses, corner_positions
from tossid.rotations import quat_boxminus, quat_exp, quat_mul, quat_rotate, quat_to_matrix
from tossid.vision._raster import cast
from tossid.vision.camera import Camera
from tossid.vision.faces import TAG_CELLS, face_of_tag, object_faces, plane_axes, tag_bitmap

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class RenderSettings:
    """How images look.

    samples: rays a pixel, spread over its area and the exposure.
    noise: sensor noise, standard deviation [grey levels].
    blur: lens blur, standard deviation [px].
    light: direction that light comes from, world frame (need not be unit).
    ambient: share of the light that has no direction, 0 to 1.
    white, black, ground: grey levels at full light.
    """

    samples: int = 16
    noise: float = 1.5
    blur: float = 0.5
    light: tuple[float, float, float] = (0.3, 0.2, 1.0)
    ambient: float = 0.55
    white: float = 225.0
    black: float = 18.0
    ground: float = 110.0

    def __post_init__(self) -> None:
        if self.samples < 1 or self.noise < 0 or self.blur < 0 or not 0 <= self.ambient <= 1:
            raise InputError("render settings: samples >= 1, noise >= 0, blur >= 0 and 0 <= ambient <= 1 are needed")


DEFAULT_IMAGES = RenderSettings()


def interpolate(q0: ArrayLike, q1: ArrayLike, s: ArrayLike) -> Array:
    """Configurations between two, at shares s of the way: straight positions and joints, shortest turn.

    (*b, nq), (*b, nq), (*b) -> (*b, nq).
    """
    q0, q1 = np.asarray(q0, dtype=float), np.asarray(q1, dtype=float)
    share = np.asarray(s, dtype=float)[..., None]
    q = q0 + share * (q1 - q0)
    q[..., 3:7] = quat_mul(q0[..., 3:7], quat_exp(share * quat_boxminus(q1[..., 3:7], q0[..., 3:7])))
    return q


class Renderer:
    """Draws an object as the cameras see it. Safe to use from several threads.

    Args:
        model: the object; its tags are drawn on its faces.
        cameras: cameras of known pose.
        settings: how images look.

    Raises:
        ObjectError: a tag lies on no face of the object.
    """

    def __init__(
        self, model: ObjectModel, cameras: Sequence[Camera], settings: RenderSettings = DEFAULT_IMAGES
    ) -> None:
        self.model = model
        self.settings = settings
        self.cameras = {camera.name: camera for camera in cameras}
        self._faces = object_faces(model)
        self._axes = [plane_axes(face.normal) for face in self._faces]
        self._outline()
        self._place_tags()
        count = settings.samples
        steps = np.arange(count) / count
        # a rank-one lattice: powers of the reciprocal of the root of g^3 = g + 1 spread well in the plane
        g = 1.32471795724474602596
        self._samples = np.stack([(steps * count / g) % 1, (steps * count / g**2) % 1, steps], axis=-1)
        self._still = np.column_stack([self._samples[:, :2], np.zeros(count)])
        # drawn once, as drawing it anew for each frame would cost more than all the rest;
        # a frame takes its own stretch of it
        longest = max(camera.resolution[0] * camera.resolution[1] for camera in cameras)
        bank = np.random.default_rng(0).standard_normal(8 * longest, dtype=np.float32)
        self._noise = np.float32(settings.noise) * bank
        self._background = {name: _background(camera, settings) for name, camera in self.cameras.items()}

    def _outline(self) -> None:
        most = max(len(face.polygon) for face in self._faces)
        self._n_edges = np.array([len(face.polygon) for face in self._faces], dtype=np.int64)
        # polygons padded with their first corner
        self._polygons = np.stack(
            [
                np.concatenate([face.polygon, np.repeat(face.polygon[:1], most - len(face.polygon), 0)])
                for face in self._faces
            ]
        )

    def _place_tags(self) -> None:
        by_face: list[list[int]] = [[] for _ in self._faces]
        for index, tag in enumerate(self.model.tags):
            by_face[face_of_tag(tag, self._faces)].append(index)
        self._face_tags = np.zeros((len(self._faces), 2), dtype=np.int64)
        maps: list[Any] = []
        bitmaps: list[NDArray[np.uint8]] = []
        for f, indices in enumerate(by_face):
            self._face_tags[f] = len(maps), len(indices)
            right, up = self._axes[f]
            for index in indices:
                tag = self.model.tags[index]
                x_axis, y_axis = tag.T_body_tag[:3, 0], tag.T_body_tag[:3, 1]
                offset = self._faces[f].center - tag.T_body_tag[:3, 3]
                scale = TAG_CELLS / tag.size
                maps.append(
                    [
                        [scale * right @ x_axis, scale * up @ x_axis, scale * offset @ x_axis + TAG_CELLS / 2],
                        [-scale * right @ y_axis, -scale * up @ y_axis, -scale * offset @ y_axis + TAG_CELLS / 2],
                    ]
                )
                bitmaps.append(tag_bitmap(tag.id))
        self._tag_map = np.array(maps, dtype=float).reshape(-1, 2, 3)
        self._bitmaps = np.array(bitmaps, dtype=np.uint8).reshape(-1, TAG_CELLS, TAG_CELLS)

    def render(self, q0: ArrayLike, q1: ArrayLike, camera: str, rng: np.random.Generator | None) -> Image:
        """One image.

        Args:
            q0, q1: (nq,) configurations when the shutter opens and closes.
            camera: its name.
            rng: source of the sensor's noise; None for an image without noise.

        Returns:
            (height, width) grey levels.
        """
        if camera not in self.cameras:
            raise InputError(f"no camera '{camera}' among {', '.join(self.cameras)}")
        cam, settings = self.cameras[camera], self.settings
        q0, q1 = np.asarray(q0, dtype=float), np.asarray(q1, dtype=float)
        sharp, blurred = self._background[camera]
        image = blurred.copy()
        region = self._region(cam, q0, q1)
        if region is not None:
            x0, y0, x1, y1 = region
            canvas = np.ascontiguousarray(sharp[y0:y1, x0:x1])
            self._cast(canvas, x0, y0, cam, q0, q1, rng)
            if settings.blur > 0:
                image[y0:y1, x0:x1] = cv2.GaussianBlur(canvas, (0, 0), settings.blur, borderType=cv2.BORDER_REPLICATE)
            else:
                image[y0:y1, x0:x1] = canvas
        if rng is not None and settings.noise > 0:
            first = int(rng.integers(len(self._noise) - image.size))
            image += self._noise[first : first + image.size].reshape(image.shape)
        return np.asarray(cv2.convertScaleAbs(np.clip(image, 0, 255)), dtype=np.uint8)

    def _cast(
        self, canvas: NDArray[np.float32], x0: int, y0: int, cam: Camera, q0: Array, q1: Array, rng: object
    ) -> None:
        settings = self.settings
        moving = not np.array_equal(q0, q1)
        shares = (np.arange(settings.samples) + 0.5) / settings.samples if moving else np.array([0.5])
        n = len(shares)
        q = interpolate(np.repeat(q0[None], n, axis=0), np.repeat(q1[None], n, axis=0), shares)
        position, quat = body_poses(self.model, q)
        body = np.array([face.body for face in self._faces])
        R_cam = cam.T_cam_world[:3, :3] @ quat_to_matrix(quat[:, body])
        p_cam = position[:, body] @ cam.T_cam_world[:3, :3].T + cam.T_cam_world[:3, 3]
        center = np.squeeze(R_cam @ np.stack([face.center for face in self._faces])[:, :, None], -1) + p_cam
        polygons = self._polygons @ np.swapaxes(R_cam, -1, -2) + p_cam[..., None, :]
        edges = _cross(polygons, np.roll(polygons, -1, axis=-2))
        edges *= -np.sign(np.sum(edges * center[..., None, :], axis=-1, keepdims=True))  # the middle is inside
        planes = np.empty((n, len(self._faces), 12))
        axes = (np.stack([face.normal for face in self._faces]), *np.stack(self._axes, axis=1))
        for k, axis in enumerate(axes):
            world = np.squeeze(R_cam @ axis[:, :, None], -1)
            planes[..., 4 * k : 4 * k + 3] = world
            planes[..., 4 * k + 3] = np.sum(world * center, axis=-1)
        seed = int(rng.integers(2**31)) if isinstance(rng, np.random.Generator) else 0
        cast(
            canvas,
            x0,
            y0,
            cam.rays,
            self._samples if moving else self._still,
            seed,
            planes,
            planes[..., 3] < 0,
            edges,
            self._n_edges,
            self._shade(quat[n // 2]),
            self._face_tags,
            self._tag_map,
            self._bitmaps,
            settings.white,
            settings.black,
        )

    def _shade(self, quat: Array) -> Array:
        """Lambert's law with ambient light. (n_b, 4) -> (f,)."""
        light = np.asarray(self.settings.light, dtype=float)
        light = light / np.linalg.norm(light)
        normals = np.stack([quat_rotate(quat[face.body], face.normal) for face in self._faces])
        return self.settings.ambient + (1 - self.settings.ambient) * np.clip(normals @ light, 0, 1)

    def _region(self, cam: Camera, q0: Array, q1: Array) -> tuple[int, int, int, int] | None:
        """Columns and rows [x0, x1) x [y0, y1) that the object can touch, None if it is out of view."""
        corners = corner_positions(self.model, np.stack([q0, q1])).reshape(-1, 3)
        depth = corners @ cam.T_cam_world[2, :3] + cam.T_cam_world[2, 3]
        if (depth <= 0).all():
            return None
        pixels = cam.project(corners)
        width, height = cam.resolution
        if np.isnan(pixels).any():
            return 0, 0, width, height
        # the images of straight edges bow a little under distortion
        margin = 3 + 4 * self.settings.blur + 0.03 * float(np.ptp(pixels, axis=0).max())
        x0, y0 = np.maximum(np.floor(pixels.min(axis=0) - margin), 0).astype(int)
        x1, y1 = np.minimum(np.ceil(pixels.max(axis=0) + margin), [width, height]).astype(int)
        return (int(x0), int(y0), int(x1), int(y1)) if x0 < x1 and y0 < y1 else None


def _cross(a: Array, b: Array) -> Array:
    """Cross product over the last axis, without numpy's overhead."""
    x = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    y = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    z = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return np.stack([x, y, z], axis=-1)


def _background(cam: Camera, settings: RenderSettings) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The empty scene before and after the lens's blur: a ground that fades with distance, a dim wall."""
    width, height = cam.resolution
    u, v = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    xy = cam.undistort(np.stack([u, v], axis=-1))
    rays = np.concatenate([np.nan_to_num(xy), np.ones((height, width, 1))], axis=-1) @ cam.T_world_cam[:3, :3].T
    eye = cam.T_world_cam[:3, 3]
    down = rays[..., 2] < -1e-6
    reach = np.where(down, -eye[2] / np.where(down, rays[..., 2], -1.0), 0.0)
    spot = eye[:2] + reach[..., None] * rays[..., :2]
    light = np.asarray(settings.light, dtype=float)
    lit = settings.ambient + (1 - settings.ambient) * max(light[2], 0.0) / float(np.linalg.norm(light))
    grain = 3.0 * np.sin(7.0 * spot[..., 0] + 1.3) * np.sin(6.0 * spot[..., 1])  # a floor is never quite even
    ground = settings.ground * lit / (1 + 0.05 * np.sum(spot**2, axis=-1)) + grain
    sharp = np.where(down, ground, 0.5 * settings.ground).astype(np.float32)
    if settings.blur > 0:
        return sharp, np.asarray(cv2.GaussianBlur(sharp, (0, 0), settings.blur), dtype=np.float32)
    return sharp, sharp
