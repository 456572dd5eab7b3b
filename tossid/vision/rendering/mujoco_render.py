"""The same images from MuJoCo's own renderer, for machines that have EGL or OSMesa."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import cv2
import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tossid.errors import InputError
from tossid.objects import ObjectModel, body_poses
from tossid.rotations import matrix_to_quat, quat_mul
from tossid.settings.rendering import RenderSettings
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.shutter import interpolate
from tossid.vision.rendering.render import DEFAULT_IMAGES, Image
from tossid.vision.setup.faces import tag_bitmap, tag_corners

Array = NDArray[np.float64]

SCALE = 2
"""Virtual pixels along a pixel."""
LIFT = 5e-5
"""Height of the tags' pictures over the faces [m]."""
EXPOSURES = 4
"""Images whose mean is the motion blur."""
TEXELS = 32
"""Texels along a tag's cell."""


def gl_context(width: int, height: int) -> Any:
    """An off-screen OpenGL context, from EGL or else OSMesa (or what MUJOCO_GL names).

    Raises:
        InputError: the machine has neither.
    """
    asked = os.environ.get("MUJOCO_GL", "").lower()
    problems = []
    for name in [asked] if asked in ("egl", "osmesa") else ["egl", "osmesa"]:
        try:
            module = __import__(f"mujoco.{name}", fromlist=["GLContext"])
            context = module.GLContext(width, height)
            context.make_current()
        # whatever these drivers raise means that they cannot be used
        except Exception as error:
            problems.append(f"{name}: {str(error).strip().splitlines()[0] if str(error).strip() else 'not usable'}")
        else:
            return context
    raise InputError(
        f"MuJoCo's renderer needs EGL or OSMesa, and this machine has neither ({'; '.join(problems)}). "
        "The default renderer needs no OpenGL."
    )


class MujocoRenderer:
    """Draws an object with MuJoCo, with the same call as `render.Renderer`. To be used from one thread.

    A wider image without distortion is drawn at twice the resolution and then
    seen through the camera's lens model. Motion blur is the mean of `EXPOSURES` images.
    """

    def __init__(
        self,
        model: ObjectModel,
        cameras: Sequence[Camera],
        settings: RenderSettings = DEFAULT_IMAGES,
    ) -> None:
        """Compile the scene and open a context.

        Args:
            model: The object; its tags are drawn on its faces.
            cameras: Cameras of known pose.
            settings: How images look; this renderer draws no glare, depth of field, texture, litter or hand.

        Raises:
            InputError: Neither EGL nor OSMesa is there.
        """
        self.model = model
        self.settings = settings
        self.cameras = {camera.name: camera for camera in cameras}
        self._views = {camera.name: _view(camera) for camera in cameras}
        width = max(view[0] for view in self._views.values())
        height = max(view[1] for view in self._views.values())
        self._scene_model = self._compile(width, height)
        self._data = mujoco.MjData(self._scene_model)
        self._gl = gl_context(width, height)
        self._context = mujoco.MjrContext(self._scene_model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._scene = mujoco.MjvScene(self._scene_model, maxgeom=100 + 4 * len(model.tags))
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = 0
        self._camera = mujoco.MjvCamera()

    def _compile(self, width: int, height: int) -> mujoco.MjModel:
        spec = mujoco.MjSpec()
        settings = self.settings
        spec.visual.global_.offwidth, spec.visual.global_.offheight = width, height
        spec.visual.headlight.ambient = [settings.ambient] * 3
        spec.visual.headlight.diffuse = [0.0] * 3
        spec.visual.headlight.specular = [0.0] * 3
        spec.visual.map.znear, spec.visual.map.zfar = 0.05, 20.0
        spec.stat.extent, spec.stat.center = 1.0, [0.0, 0.0, 0.0]
        spec.worldbody.add_light(
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            dir=(-np.asarray(settings.light)).tolist(),
            diffuse=[1 - settings.ambient] * 3,
            ambient=[0.0] * 3,
            specular=[0.0] * 3,
            castshadow=False,
        )
        unseen: dict[str, Any] = {"contype": 0, "conaffinity": 0}
        ground = settings.ground / 255
        plain: dict[str, Any] = {"specular": 0.0, "shininess": 0.0, "reflectance": 0.0}
        spec.add_material(name="ground", rgba=[ground, ground, ground, 1], **plain)
        spec.add_material(name="white", rgba=[settings.white / 255] * 3 + [1], **plain)
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], material="ground", pos=[0, 0, -1e-3], **unseen
        )
        for b in range(self.model.n_bodies):
            body = spec.worldbody.add_body(name=f"body_{b}", mocap=True)
            own = self.model.drawn.corner_pos[self.model.drawn.corner_body == b]
            if len(own):
                hull = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
                spec.add_mesh(name=f"hull_{b}", uservert=own.ravel(), inertia=hull)
                body.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"hull_{b}", material="white", mass=0.0, **unseen
                )
            for tag in self.model.tags:
                if tag.body == b:
                    self._add_tag(spec, body, tag, plain, unseen)
        for name, camera in self.cameras.items():
            turned = quat_mul(matrix_to_quat(camera.T_world_cam[:3, :3]), [0.0, 1.0, 0.0, 0.0])  # y up, looks along -z
            fovy = 2 * np.rad2deg(np.arctan(0.5 * self._views[name][1] / self._views[name][2]))
            spec.worldbody.add_camera(name=name, pos=camera.T_world_cam[:3, 3], quat=turned, fovy=fovy)
        return spec.compile()

    def _add_tag(self, spec: mujoco.MjSpec, body: Any, tag: Any, plain: dict[str, Any], unseen: dict[str, Any]) -> None:
        name = f"tag_{tag.id}"
        level = np.where(tag_bitmap(tag.id) > 0, self.settings.white, self.settings.black).astype(np.uint8)
        picture = np.repeat(np.repeat(level, TEXELS, axis=0), TEXELS, axis=1)
        texture = spec.add_texture(
            name=name,
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            width=picture.shape[1],
            height=picture.shape[0],
            nchannel=3,
        )
        texture.data = np.repeat(picture[:, :, None], 3, axis=2).tobytes()
        material = spec.add_material(name=name, **plain)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
        corners = tag_corners(tag) + LIFT * tag.T_body_tag[:3, 2]
        spec.add_mesh(
            name=name,
            uservert=corners.ravel(),
            userface=[0, 1, 2, 0, 2, 3],
            # the picture's first row is at v = 0 here, its last at v = 1
            usertexcoord=[0, 1, 1, 1, 1, 0, 0, 0],
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, material=name, mass=0.0, **unseen)

    def render(self, q0: ArrayLike, q1: ArrayLike, camera: str, rng: np.random.Generator | None) -> Image:
        """One image, as `render.Renderer.render`."""
        if camera not in self.cameras:
            raise InputError(f"no camera '{camera}' among {', '.join(self.cameras)}")
        q0, q1 = np.asarray(q0, dtype=float), np.asarray(q1, dtype=float)
        n = 1 if np.array_equal(q0, q1) else EXPOSURES
        width, height, _, map_x, map_y = self._views[camera]
        total = np.zeros((height, width), dtype=np.float32)
        pixels = np.empty((height, width, 3), dtype=np.uint8)
        self._gl.make_current()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._camera.fixedcamid = self._scene_model.camera(camera).id
        for share in (np.arange(n) + 0.5) / n:
            position, quat = body_poses(self.model, interpolate(q0, q1, share))
            self._data.mocap_pos[:], self._data.mocap_quat[:] = position, quat
            mujoco.mj_kinematics(self._scene_model, self._data)
            mujoco.mj_camlight(self._scene_model, self._data)
            mujoco.mjv_updateScene(
                self._scene_model,
                self._data,
                mujoco.MjvOption(),
                None,
                self._camera,
                mujoco.mjtCatBit.mjCAT_ALL,
                self._scene,
            )
            port = mujoco.MjrRect(0, 0, width, height)
            mujoco.mjr_render(port, self._scene, self._context)
            mujoco.mjr_readPixels(pixels, None, port, self._context)
            total += pixels[::-1, :, 1]
        # the mean over a pixel's area, then the lens's own blur
        seen = cv2.GaussianBlur(total / n, (0, 0), SCALE * float(np.hypot(1 / np.sqrt(12), self.settings.blur)))
        image = cv2.remap(seen, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        level = np.asarray(image, dtype=float)
        if rng is not None and self.settings.noise > 0:
            level += self.settings.noise * rng.standard_normal(level.shape)
        return np.asarray(np.clip(np.round(level), 0, 255), dtype=np.uint8)


def _view(camera: Camera) -> tuple[int, int, float, NDArray[np.float32], NDArray[np.float32]]:
    """Width and height [px] and focal length [px] of the virtual image, and where each pixel lies in it."""
    width, height = camera.resolution
    u, v = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    xy = camera.undistort(np.stack([u, v], axis=-1))
    if np.isnan(xy).any() or np.abs(xy).max() > 3:
        raise InputError(f"camera '{camera.name}' sees too wide an angle for MuJoCo's renderer")
    focal = SCALE * float(camera.intrinsics[1])
    half = focal * np.abs(xy).reshape(-1, 2).max(axis=0) + SCALE
    size = 2 * np.ceil(half).astype(int)
    map_xy = (focal * xy + size / 2 - 0.5).astype(np.float32)
    return int(size[0]), int(size[1]), focal, map_xy[..., 0].copy(), map_xy[..., 1].copy()
