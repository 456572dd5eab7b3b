"""How far a scene's corners are from where its poses project them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.rotations import transform_inv
from tossid.vision.pose_graph.corner_projection import corner_errors
from tossid.vision.pose_graph.resect import chi2_scale, retract
from tossid.vision.pose_graph.scene import Scene
from tossid.vision.pose_graph.state import State, TimingModel, by_step
from tossid.vision.setup.layout import SQUARE

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class ReprojectionErrors:
    """Reprojection errors of each sighting's four corners; NaN where a pose between camera and tag is unknown.

    Attributes:
        pixels: Root mean square over the corners of their distance from where they are projected, less the likeliest
            spread of the tag's edges [px], (d,).
        whitened: Root mean square of the eight whitened components of the same [1], (d,).
        expected_pixels: What `pixels` is of errors as large as the corners' covariances say [px], (d,).
        spread: Least-squares estimate of the edges' spread in this frame [px], (d,).
        spread_certainty: One over the estimate's standard deviation, in units of the corners' noise [1/px], (d,).
        raw_pixels: As `pixels`, with the spread left in [px], (d,).
        raw_whitened: As `whitened`, with the spread left in [1], (d,).
    """

    pixels: Array
    whitened: Array
    expected_pixels: Array
    spread: Array
    spread_certainty: Array
    raw_pixels: Array
    raw_whitened: Array

    def scale(self, scene: Scene, used: Bools) -> float:
        """Noise of residuals over the corners' own: `chi2_scale` over time steps.

        Each step's pose takes six degrees of freedom. 1 where fewer than 20 steps have two tags or more.

        Args:
            scene: The sightings.
            used: Those to use, (d,).
        """
        good = used & np.isfinite(self.whitened)
        corners = 8.0 * np.bincount(scene.step[good], minlength=len(scene.t))
        steps = corners >= 16
        if steps.sum() < 20:
            return 1.0
        square = np.bincount(scene.step[good], 8 * self.whitened[good] ** 2, minlength=len(scene.t))[steps]
        return chi2_scale(square, corners[steps] - 6)


def reproject(
    scene: Scene, state: State, timing: TimingModel | None = None, *, spread_sigma: float = 0.0
) -> ReprojectionErrors:
    """Reprojection errors of all sightings.

    Args:
        scene: The sightings.
        state: The poses.
        timing: Motion between a step and a frame's own time; None for none.
        spread_sigma: Standard deviation of the spread of tags' edges, over the noise's scale [px].
    """
    rig, body = scene.rig[scene.camera], scene.body[scene.tag]
    T_world_rig, T_world_body = state.at(rig, scene.step), state.at(body, scene.step)
    if timing is not None:
        delay = (scene.delay - timing.clock[scene.camera])[:, None]
        T_world_rig, T_world_body = (
            retract(T, delay * by_step(timing.twist, index, scene.step))
            for T, index in ((T_world_rig, rig), (T_world_body, body))
        )
    T_cam_tag = transform_inv(state.camera[scene.camera]) @ transform_inv(T_world_rig) @ T_world_body
    corners = scene.half[:, None, None] * printed_corners(state.prints[scene.tag])
    flat = corner_errors(T_cam_tag @ state.tag[scene.tag], corners, scene.seen)
    whiten = scene.whiten / np.sqrt(scene.count)[:, None, None, None]
    growth = np.squeeze(whiten @ scene.edge_growth[..., None], -1)
    certainty2 = np.sum(growth**2, axis=(1, 2))
    raw_whitened = np.squeeze(whiten @ flat[..., None], -1)
    along = -np.sum(growth * raw_whitened, axis=(1, 2))
    raw = np.squeeze(scene.to_pixels @ flat[..., None], -1)
    # the posterior mean of the spread under its prior N(0, spread_sigma²)
    flat = flat + (along * spread_sigma**2 / (1 + spread_sigma**2 * certainty2))[:, None, None] * scene.edge_growth
    left = np.squeeze(scene.to_pixels @ flat[..., None], -1)
    whitened = np.squeeze(whiten @ flat[..., None], -1)
    root = scene.to_pixels @ np.linalg.inv(whiten)
    return ReprojectionErrors(
        pixels=np.sqrt(np.mean(np.sum(left**2, axis=-1), axis=1)),
        whitened=np.sqrt(np.mean(whitened**2, axis=(1, 2))),
        expected_pixels=np.sqrt(np.mean(np.sum(root**2, axis=(-1, -2)), axis=1)),
        spread=along / certainty2,
        spread_certainty=np.sqrt(certainty2),
        raw_pixels=np.sqrt(np.mean(np.sum(raw**2, axis=-1), axis=1)),
        raw_whitened=np.sqrt(np.mean(raw_whitened**2, axis=(1, 2))),
    )


def printed_corners(prints: Array) -> Array:
    """Corners of tags of half size 1 whose prints are wider, higher and twisted, (*b, 4, 3).

    Args:
        prints: Shares of the size by which each is wider, higher, and twisted out of its plane, (*b, 3).
    """
    x, y = (SQUARE[:, k] * (1 + prints[..., k, None]) for k in (0, 1))
    return np.stack([x, y, SQUARE[:, 0] * SQUARE[:, 1] * prints[..., 2, None]], axis=-1)
