"""How far a scene's corners are from where its poses project them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.rotations import transform_inv
from tossid.vision.pose_graph.corner_projection import corner_residuals
from tossid.vision.pose_graph.resect import chi2_scale, retract
from tossid.vision.pose_graph.scene import Scene
from tossid.vision.pose_graph.state import State, TimingModel
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


class Chain(NamedTuple):
    """The transforms between each sighting's camera and tag, (d, 4, 4).

    X_cam = T_rig_cam⁻¹ · (T_world_rig M_rig(δ))⁻¹ · T_world_body M_body(δ) · T_body_tag · X_tag, where M(δ) is the
    motion from the step to the frame's own time δ after it.

    Attributes:
        T_cam_rig: The camera on its rig.
        rig_motion_inv: M_rig(δ)⁻¹.
        T_rig_body: In the time step.
        body_motion: M_body(δ).
        T_body_tag: The tag on its body.
    """

    T_cam_rig: Array
    rig_motion_inv: Array
    T_rig_body: Array
    body_motion: Array
    T_body_tag: Array

    @property
    def T_cam_tag(self) -> Array:
        """Their product, (d, 4, 4)."""
        return self.T_cam_rig @ self.rig_motion_inv @ self.T_rig_body @ self.body_motion @ self.T_body_tag


def chain_of(scene: Scene, state: State, timing: TimingModel, *, T_rig_cam: Array | None = None) -> Chain:
    """The transforms between all sightings' cameras and tags.

    Args:
        scene: The sightings.
        state: The poses.
        timing: Motion between a step and a frame's own time.
        T_rig_cam: Of each sighting's camera, (d, 4, 4); None: as in `state`.
    """
    rig, body, still = scene.rig[scene.camera], scene.body[scene.tag], np.eye(4)
    T_rig_cam = state.camera[scene.camera] if T_rig_cam is None else T_rig_cam
    delay = (scene.delay - timing.clock[scene.camera])[:, None]
    rig_motion, body_motion = (
        retract(np.broadcast_to(still, (len(delay), 4, 4)), delay * timing.rate(b, scene.step)) for b in (rig, body)
    )
    T_rig_body = transform_inv(state.at(rig, scene.step)) @ state.at(body, scene.step)
    T_cam_rig, T_body_tag = transform_inv(T_rig_cam), state.tag[scene.tag]
    return Chain(T_cam_rig, transform_inv(rig_motion), T_rig_body, body_motion, T_body_tag)


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
    T_cam_tag = chain_of(scene, state, timing or TimingModel.none(scene)).T_cam_tag
    corners = scene.half[:, None, None] * printed_corners(state.prints[scene.tag])
    flat, _ = corner_residuals(T_cam_tag, corners, scene.seen, np.tile(np.eye(2), (len(corners), 4, 1, 1)))
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
