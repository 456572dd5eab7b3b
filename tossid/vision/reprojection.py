"""How far a scene's corners are from where its poses project them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.rotations import transform_inv, transform_points
from tossid.vision.graph import Motion
from tossid.vision.initial import State
from tossid.vision.resect import SQUARE, retract
from tossid.vision.scene import Scene

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Errors:
    """Reprojection of each sighting's four corners: NaN where something on the way is not placed.

    vector: (d, 4, 2) projected minus seen [px]. pixels: (d,) rms distance [px]. whitened: (d,) rms over the
    eight components of the same, over what a single frame promises. promise: (d,) rms distance that it does [px].
    """

    vector: Array
    pixels: Array
    whitened: Array
    promise: Array

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


def reproject(scene: Scene, state: State, motion: Motion | None = None) -> Errors:
    """Reprojection errors of all sightings.

    Args:
        motion: of bodies while frames of one step differ in time, None for none.
    """
    rig, body = scene.rig[scene.camera], scene.body[scene.tag]
    T_world_rig, T_world_body = state.at(rig, scene.step), state.at(body, scene.step)
    if motion is not None:
        late = (scene.late - motion.clock[scene.camera])[:, None]
        T_world_rig, T_world_body = (
            retract(T, late * _twists(motion, index, scene)) for T, index in ((T_world_rig, rig), (T_world_body, body))
        )
    T_cam_tag = transform_inv(state.camera[scene.camera]) @ transform_inv(T_world_rig) @ T_world_body
    x = transform_points(T_cam_tag @ state.tag[scene.tag], scene.half[:, None, None] * SQUARE)
    x = np.where(x[..., 2:] > 0, x, np.nan)
    flat = x[..., :2] / x[..., 2:] - scene.seen
    vector = np.squeeze(scene.to_pixels @ flat[..., None], -1)
    whiten = scene.whiten / np.sqrt(scene.count)[:, None, None, None]
    whitened = np.squeeze(whiten @ flat[..., None], -1)
    root = scene.to_pixels @ np.linalg.inv(whiten)
    return Errors(
        vector,
        np.sqrt(np.mean(np.sum(vector**2, axis=-1), axis=1)),
        np.sqrt(np.mean(whitened**2, axis=(1, 2))),
        np.sqrt(np.mean(np.sum(root**2, axis=(-1, -2)), axis=1)),
    )


def _twists(motion: Motion, body: NDArray[np.int64], scene: Scene) -> Array:
    out = np.zeros((len(body), 6))
    for b, twist in enumerate(motion.twist):
        own = body == b
        out[own] = twist[scene.step[own] if len(twist) > 1 else np.zeros(own.sum(), dtype=np.int64)]
    return out
