"""Synthetic tosses as a recording of camera frames: a hand brings the object, lets go, it comes to rest; again."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipelines.console import Console
from pipelines.schemas import CameraConfig, SynthesizeConfig
from tossid.objects import ObjectModel
from tossid.types import PoseTrack, Toss
from tossid.vision.camera import Camera
from tossid.vision.files import write_tracks
from tossid.vision.layout import layout_of
from tossid.vision.recording import RecordingWriter
from tossid.vision.render import RenderSettings
from tossid.vision.rig import default_rig
from tossid.vision.timeline import make_timeline, render_timeline

START = 1.0
"""Time of the first frame [s]."""

TRUE_POSES = "truth_poses.npz"
"""The object's true pose in every frame, in the hand too."""


@dataclass(frozen=True)
class Filmed:
    """tosses: the true ones, on the recording's clock. n_images: written. cameras: their names."""

    tosses: tuple[Toss, ...]
    n_images: int
    cameras: tuple[str, ...]


def film(
    config: SynthesizeConfig,
    model: ObjectModel,
    tosses: Sequence[Toss],
    folder: Path,
    rng: np.random.Generator,
    console: Console,
) -> Filmed:
    """Render tosses into a recording.

    Args:
        tosses: true tosses.
        folder: an empty folder that becomes the recording.
        rng: of the hand and of the images' noise.
    """
    cameras = make_cameras(config.camera, rate_hz=config.rate_hz)
    timeline = make_timeline(tosses, model, rng, start=START, carry=config.camera.carry_s, rest=config.camera.pause_s)
    n_images = len(timeline.t) * len(cameras)
    settings = RenderSettings(samples=config.camera.samples, noise=config.camera.noise, blur=config.camera.blur)
    renderer = None
    if config.camera.renderer == "mujoco":
        from tossid.vision.mujoco_render import MujocoRenderer

        renderer = MujocoRenderer(model, cameras, settings)
    inner = folder / "recording"  # the writer's own temporaries then lie inside ours
    with (
        RecordingWriter(inner, cameras, layout_of(model), quality=config.camera.quality) as writer,
        console.progress("render", n_images, unit="images") as progress,
    ):
        render_timeline(
            timeline,
            model,
            cameras,
            writer,
            rng,
            settings=settings,
            renderer=renderer,
            exposure=config.camera.exposure_s,
            threads=os.cpu_count() or 1,
            progress=progress.advance,
        )
    for entry in inner.iterdir():
        entry.rename(folder / entry.name)
    inner.rmdir()
    write_tracks([PoseTrack("truth", timeline.t, timeline.q)], folder / TRUE_POSES)
    return Filmed(timeline.tosses, n_images, tuple(camera.name for camera in cameras))


def make_cameras(config: CameraConfig, *, rate_hz: float) -> tuple[Camera, ...]:
    """The cameras that the keys describe."""
    return default_rig(
        n_cameras=config.count,
        resolution=(config.width, config.height),
        rate_hz=rate_hz,
        area=config.area,
        distance=config.distance,
        elevation_deg=config.elevation_deg,
        distorted=config.distorted,
    )
