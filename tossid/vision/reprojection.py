"""How far a scene's corners are from where its poses project them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.rotations import transform_inv, transform_points
from tossid.vision.initial import State
from tossid.vision.resect import SQUARE, retract
from tossid.vision.scene import Scene
from tossid.vision.solution import Motion

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Errors:
    """Reprojection of each sighting's four corners: NaN where something on the way is not placed.

    vector: (d, 4, 2) projected minus seen [px], without what the tag's edges seem to have spread. pixels: (d,) rms
    distance [px]. whitened: (d,) rms over the eight components of the same, over what a single frame promises.
    promise: (d,) rms distance that it does [px]. spread: (d,) by how much the edges seem to have spread [px], with
    nothing assumed of it, and told: (d,) how well one frame's corners tell, over their noise [1/px]. bare: (d,) rms
    distance with the spread [px], and bare_whitened: (d,) as whitened.
    """

    vector: Array
    pixels: Array
    whitened: Array
    promise: Array
    spread: Array
    told: Array
    bare: Array
    bare_whitened: Array

    def scale(self, scene: Scene, used: Bools) -> float:
        """Residuals over their promised size: root of the median over steps of χ² by its degrees of freedom.

        Each step's pose takes six degrees of freedom. 1 with fewer than 20 steps of two tags or more.
        """
        good = used & np.isfinite(self.whitened)
        corners = 8.0 * np.bincount(scene.step[good], minlength=len(scene.t))
        steps = corners >= 16
        if steps.sum() < 20:
            return 1.0
        square = np.bincount(scene.step[good], 8 * self.whitened[good] ** 2, minlength=len(scene.t))[steps]
        freedom = corners[steps] - 6
        # the median of χ² with k degrees of freedom is about k (1 - 2/(9k))³
        return float(np.clip(np.sqrt(np.median(square / (freedom * (1 - 2 / (9 * freedom)) ** 3))), 0.05, 30.0))


def reproject(scene: Scene, state: State, motion: Motion | None = None, *, swell: float = 0.0) -> Errors:
    """Reprojection errors of all sightings.

    Args:
        motion: of bodies while frames of one step differ in time, None for none. swell: of `Flaws`.
    """
    rig, body = scene.rig[scene.camera], scene.body[scene.tag]
    T_world_rig, T_world_body = state.at(rig, scene.step), state.at(body, scene.step)
    if motion is not None:
        late = (scene.late - motion.clock[scene.camera])[:, None]
        T_world_rig, T_world_body = (
            retract(T, late * _twists(motion, index, scene)) for T, index in ((T_world_rig, rig), (T_world_body, body))
        )
    T_cam_tag = transform_inv(state.camera[scene.camera]) @ transform_inv(T_world_rig) @ T_world_body
    x = transform_points(T_cam_tag @ state.tag[scene.tag], scene.half[:, None, None] * printed(state.prints[scene.tag]))
    x = np.where(x[..., 2:] > 0, x, np.nan)
    flat = x[..., :2] / x[..., 2:] - scene.seen
    whiten = scene.whiten / np.sqrt(scene.count)[:, None, None, None]
    grown = np.squeeze(whiten @ scene.grow[..., None], -1)
    told2 = np.sum(grown**2, axis=(1, 2))
    bare_whitened = np.squeeze(whiten @ flat[..., None], -1)
    along = -np.sum(grown * bare_whitened, axis=(1, 2))
    bare = np.squeeze(scene.to_pixels @ flat[..., None], -1)
    # as much of the spread as its own standard deviation makes likely
    flat = flat + (along * swell**2 / (1 + swell**2 * told2))[:, None, None] * scene.grow
    vector = np.squeeze(scene.to_pixels @ flat[..., None], -1)
    whitened = np.squeeze(whiten @ flat[..., None], -1)
    root = scene.to_pixels @ np.linalg.inv(whiten)
    return Errors(
        vector,
        np.sqrt(np.mean(np.sum(vector**2, axis=-1), axis=1)),
        np.sqrt(np.mean(whitened**2, axis=(1, 2))),
        np.sqrt(np.mean(np.sum(root**2, axis=(-1, -2)), axis=1)),
        along / told2,
        np.sqrt(told2),
        np.sqrt(np.mean(np.sum(bare**2, axis=-1), axis=1)),
        np.sqrt(np.mean(bare_whitened**2, axis=(1, 2))),
    )


def printed(prints: Array) -> Array:
    """Corners of tags of half size 1, wider, higher and twisted by these shares of it. (*b, 3) -> (*b, 4, 3)."""
    x, y = (SQUARE[:, k] * (1 + prints[..., k, None]) for k in (0, 1))
    return np.stack([x, y, SQUARE[:, 0] * SQUARE[:, 1] * prints[..., 2, None]], axis=-1)


def _twists(motion: Motion, body: NDArray[np.int64], scene: Scene) -> Array:
    out = np.zeros((len(body), 6))
    for b, twist in enumerate(motion.twist):
        own = body == b
        out[own] = twist[scene.step[own] if len(twist) > 1 else np.zeros(own.sum(), dtype=np.int64)]
    return out
