"""Camera images of a moving object with tags, drawn on the CPU without OpenGL.

Perspective and lens distortion are exact (rays are cast through the camera
model), edges are antialiased and motion is blurred by sampling each pixel over
its area and the exposure; then come the lens's blur and the sensor's noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.objects import ObjectModel, body_poses, corner_positions
from tossid.rotations import quat_rotate, quat_to_matrix, transform, transform_points
from tossid.settings.rendering import RenderSettings
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.shutter import Exposure
from tossid.vision.rendering._raster import Faces, Optics, Prints, cast, visible_shares
from tossid.vision.rendering.backdrop import Levels, backdrop
from tossid.vision.rendering.hand import hand_faces
from tossid.vision.setup.faces import TAG_CELLS, face_of_tag, object_faces, plane_axes, tag_bitmap

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


DEFAULT_IMAGES = RenderSettings()
LIGHT = np.array([0.3, 0.2, 1.0]) / np.linalg.norm([0.3, 0.2, 1.0])
"""Direction that light comes from, world frame."""
LAMP = 2.0
"""Distance of the lamp from the origin [m]."""
BLACK, GROUND = 18.0, 110.0
"""Grey levels of ink and of the ground at full light."""


class Renderer:
    """Draws an object as the cameras see it. Safe to use from several threads."""

    def __init__(
        self, model: ObjectModel, cameras: Sequence[Camera], settings: RenderSettings = DEFAULT_IMAGES
    ) -> None:
        """Prepare the empty scene of each camera.

        Args:
            model: The object; its tags are drawn on its faces.
            cameras: Cameras of known pose.
            settings: How images look.

        Raises:
            ObjectError: A tag lies on no face of the object.
        """
        self.model = model
        self.settings = settings
        self.cameras = {camera.name: camera for camera in cameras}
        own = object_faces(model)
        hand, levels = hand_faces(model, body=model.n_bodies)
        self._n_own, self._faces = len(own), (*own, *hand)
        self._axes = [plane_axes(face.normal) for face in self._faces]
        self._white = np.concatenate([np.full(len(own), settings.white), levels])
        self._outline()
        self._place_tags()
        count = settings.samples
        steps = np.arange(count) / count
        # a rank-one lattice: powers of the reciprocal of the root of g^3 = g + 1 spread well in the plane
        g = 1.32471795724474602596
        xy = np.stack([(steps * count / g) % 1, (steps * count / g**2) % 1], axis=-1)
        opening = np.stack([(steps * count * (2**0.5 - 1)) % 1, (steps * count * (3**0.5 - 1)) % 1], axis=-1)
        self._samples = np.column_stack([xy, steps, opening])
        # drawn once, as drawing it anew for each frame would cost more than all the rest;
        # a frame takes its own stretch of it
        longest = max(camera.resolution[0] * camera.resolution[1] for camera in cameras)
        bank = np.random.default_rng(0).standard_normal(8 * longest, dtype=np.float32)
        self._noise = np.float32(settings.noise) * bank
        self._background = {name: self._empty(camera) for name, camera in self.cameras.items()}

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

    def _empty(self, camera: Camera) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The scene without the object, before and after the lens's blur."""
        settings = self.settings
        light = settings.ambient + (1 - settings.ambient) * LIGHT[2]
        levels = Levels(GROUND * light, 0.5 * GROUND, settings.texture, settings.white * light, BLACK * light)
        sharp = backdrop(camera, levels, lens=settings.lens, samples=self._samples, litter=settings.litter)
        if settings.blur > 0:
            return sharp, np.asarray(cv2.GaussianBlur(sharp, (0, 0), settings.blur), dtype=np.float32)
        return sharp, sharp

    def _place_tags(self) -> None:
        by_face: list[list[int]] = [[] for _ in self._faces]
        self._tag_face = np.array([face_of_tag(tag, self._faces) for tag in self.model.tags], dtype=np.int64)
        for index, face in enumerate(self._tag_face):
            by_face[face].append(index)
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

    def draw(self, exposure: Exposure, camera: str, rng: np.random.Generator | None) -> Image:
        """One image.

        Args:
            exposure: Where things are while it is exposed.
            camera: Name of the camera.
            rng: Source of the sensor's noise; None for an image without noise.

        Returns:
            (height, width) grey levels.

        Raises:
            InputError: There is no such camera.
        """
        cam, settings = self._camera(camera), self.settings
        sharp, blurred = self._background[camera]
        image = blurred.copy()
        region = self._region(cam, exposure)
        if region is not None:
            x0, y0, x1, y1 = region
            canvas = np.ascontiguousarray(sharp[y0:y1, x0:x1])
            self._cast(canvas, x0, y0, cam, exposure, rng)
            if settings.blur > 0:
                image[y0:y1, x0:x1] = cv2.GaussianBlur(canvas, (0, 0), settings.blur, borderType=cv2.BORDER_REPLICATE)
            else:
                image[y0:y1, x0:x1] = canvas
        if rng is not None and settings.noise > 0:
            first = int(rng.integers(len(self._noise) - image.size))
            image += self._noise[first : first + image.size].reshape(image.shape)
        return np.asarray(cv2.convertScaleAbs(np.clip(image, 0, 255)), dtype=np.uint8)

    def visible(self, exposure: Exposure, camera: str) -> Array:
        """The visible share of each tag halfway through an exposure.

        Returns:
            (m,) in the order of the model's tags: the share that faces the camera, lies in its image and is hidden by
            nothing.
        """
        cam, middle = self._camera(camera), slice(len(exposure.q) // 2, len(exposure.q) // 2 + 1)
        hand = None if exposure.hand is None else exposure.hand[middle]
        position, quat, count = self._bodies(exposure.q[middle], hand)
        faces = self._seen_from(cam, position, quat, count)
        step = (np.arange(6) + 0.5) / 6 - 0.5
        grid = np.stack([*np.meshgrid(step, step), np.zeros((6, 6))], axis=-1).reshape(-1, 3)
        spots = np.stack([transform_points(tag.T_body_tag, tag.size * grid) for tag in self.model.tags])
        body = [tag.body for tag in self.model.tags]
        world = transform_points(transform(position[0, body], quat[0, body]), spots)
        inside = cam.contains(cam.project(world), margin=-0.5)
        spots = np.where(inside[..., None], transform_points(cam.T_cam_world, world), -1.0)
        shares = np.zeros(len(spots))
        visible_shares(faces, spots, self._tag_face, shares)
        return shares

    def _camera(self, name: str) -> Camera:
        if name not in self.cameras:
            raise InputError(f"no camera '{name}' among {', '.join(self.cameras)}")
        return self.cameras[name]

    def _bodies(self, q: Array, hand: Array | None) -> tuple[Array, Array, int]:
        """Poses of the object's bodies (k, n_b, 3), (k, n_b, 4), the hand's last, and how many faces they have."""
        position, quat = body_poses(self.model, q)
        if hand is None:
            return position, quat, self._n_own
        there = np.asarray(np.isfinite(hand).all(axis=1))
        pose = np.where(there[:, None], hand, [0.0, 0.0, -1e6, 1.0, 0.0, 0.0, 0.0])
        return (
            np.concatenate([position, pose[:, None, :3]], axis=1),
            np.concatenate([quat, pose[:, None, 3:]], axis=1),
            len(self._faces),
        )

    def _seen_from(self, cam: Camera, position: Array, quat: Array, count: int) -> Faces:
        """The first faces as a camera sees them over k times (see `_raster.Faces`)."""
        faces = self._faces[:count]
        body = np.array([face.body for face in faces])
        R_cam = cam.T_cam_world[:3, :3] @ quat_to_matrix(quat[:, body])
        p_cam = position[:, body] @ cam.T_cam_world[:3, :3].T + cam.T_cam_world[:3, 3]
        center = np.squeeze(R_cam @ np.stack([face.center for face in faces])[:, :, None], -1) + p_cam
        polygons = self._polygons[:count] @ np.swapaxes(R_cam, -1, -2) + p_cam[..., None, :]
        edges = _cross(polygons, np.roll(polygons, -1, axis=-2))
        edges *= -np.sign(np.sum(edges * center[..., None, :], axis=-1, keepdims=True))  # the middle is inside
        planes = np.empty((len(position), count, 12))
        axes = (np.stack([face.normal for face in faces]), *np.stack(self._axes[:count], axis=1))
        for k, axis in enumerate(axes):
            world = np.squeeze(R_cam @ axis[:, :, None], -1)
            planes[..., 4 * k : 4 * k + 3] = world
            planes[..., 4 * k + 3] = np.sum(world * center, axis=-1)
        return Faces(planes, planes[..., 3] < 0, edges, self._n_edges[:count], self._boxes(polygons))

    def _boxes(self, polygons: Array) -> Array:
        """Least and greatest x and y [normalised] of faces over some time. (k, f, e, 3) -> (f, 4)."""
        depth = np.maximum(polygons[..., 2:], 1e-3)
        xy = np.where(polygons[..., 2:] > 1e-3, polygons[..., :2] / depth, np.inf)
        radius, focus = self.settings.lens
        margin = 1e-9 + radius * np.abs(1 / depth[..., 0] - 1 / focus).max(axis=(0, 2))
        low = np.where(np.isfinite(xy), xy, -np.inf).min(axis=(0, 2)) - margin[:, None]
        high = xy.max(axis=(0, 2)) + margin[:, None]
        return np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], axis=1)

    def _cast(
        self,
        canvas: NDArray[np.float32],
        x0: int,
        y0: int,
        cam: Camera,
        exposure: Exposure,
        rng: np.random.Generator | None,
    ) -> None:
        settings = self.settings
        position, quat, count = self._bodies(exposure.q, exposure.hand)
        faces = self._seen_from(cam, position, quat, count)
        if settings.aperture_m > 0:  # a face seen edge-on from the lens's middle is not so from all of it
            faces = faces._replace(front=faces.planes[..., 3] < settings.lens[0])
        shade = self._shade(quat[len(quat) // 2], count)
        seed = 0 if rng is None else int(rng.integers(2**31))
        prints = Prints(
            self._white[:count] * shade,
            BLACK * shade,
            self._face_tags[:count],
            self._tag_map,
            self._bitmaps,
        )
        lamp = transform_points(cam.T_cam_world, LAMP * LIGHT[None])[0]
        optics = Optics(exposure.rows, settings.lens, (settings.glare * settings.white, settings.gloss), lamp)
        cast(canvas, (x0, y0), cam.rays, self._samples, seed, faces, prints, optics)

    def _shade(self, quat: Array, count: int) -> Array:
        """Lambert's law with ambient light. (n_b, 4) -> (f,)."""
        normals = np.stack([quat_rotate(quat[face.body], face.normal) for face in self._faces[:count]])
        return self.settings.ambient + (1 - self.settings.ambient) * np.clip(normals @ LIGHT, 0, 1)

    def _region(self, cam: Camera, exposure: Exposure) -> tuple[int, int, int, int] | None:
        """Columns and rows [x0, x1) x [y0, y1) that the object and the hand can touch, None if out of view."""
        ends = exposure.q[[0, -1]] if exposure.rows[0] == 0 else exposure.q[:: max(len(exposure.q) // 8, 1)]
        corners = corner_positions(self.model, ends).reshape(-1, 3)
        if exposure.hand is not None:
            hand = exposure.hand[np.isfinite(exposure.hand).all(axis=1)][[0, -1]]
            boxes = transform_points(transform(hand[:, :3], hand[:, 3:]), self._polygons[self._n_own :].reshape(-1, 3))
            corners = np.concatenate([corners, boxes.reshape(-1, 3)])
        depth = corners @ cam.T_cam_world[2, :3] + cam.T_cam_world[2, 3]
        if (depth <= 0).all():
            return None
        pixels = cam.project(corners)
        width, height = cam.resolution
        if np.isnan(pixels).any():
            return 0, 0, width, height
        # the images of straight edges bow a little under distortion
        margin = 3 + 4 * self.settings.blur + 0.03 * float(np.ptp(pixels, axis=0).max())
        if self.settings.aperture_m > 0:
            radius, focus = self.settings.lens
            margin += float(cam.intrinsics[0]) * radius * float(np.abs(1 / depth - 1 / focus).max())
        x0, y0 = np.maximum(np.floor(pixels.min(axis=0) - margin), 0).astype(int)
        x1, y1 = np.minimum(np.ceil(pixels.max(axis=0) + margin), [width, height]).astype(int)
        return (int(x0), int(y0), int(x1), int(y1)) if x0 < x1 and y0 < y1 else None


def _cross(a: Array, b: Array) -> Array:
    """Cross product over the last axis, without numpy's overhead."""
    x = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    y = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    z = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return np.stack([x, y, z], axis=-1)
