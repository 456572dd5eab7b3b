"""Synthetic tosses as a recording of camera frames: a hand brings the object, lets go, it comes to rest; again."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from pipelines.console import Console
from pipelines.schemas import CameraConfig, SynthesizeConfig
from tossid.errors import ConfigError
from tossid.objects import ObjectModel
from tossid.types import PoseTrack, Toss
from tossid.vision.backdrop import scatter
from tossid.vision.camera import Camera
from tossid.vision.files import write_tracks
from tossid.vision.hand import Reach, hand_poses
from tossid.vision.layout import layout_of
from tossid.vision.recording import RecordingWriter
from tossid.vision.render import RenderSettings
from tossid.vision.rig import default_rig
from tossid.vision.shutter import Shutter
from tossid.vision.timeline import Filming, FilmTruth, Timeline, make_timeline, render_timeline

START = 1.0
"""Time of the first frame [s]."""

TRUE_POSES = "truth_poses.npz"
"""The object's true pose in every frame, in the hand too."""
TRUE_FILM = "truth_film.json"
"""How it was filmed: the cameras' clocks, the times of an image's rows, lost frames, and what got in the way."""
TRUE_VIEWS = "truth_views.npz"
"""The share of each tag that each camera could see in each frame (n, cameras, tags)."""


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
    """Render tosses into a recording, with what is true of it beside.

    Args:
        tosses: true tosses.
        folder: an empty folder that becomes the recording.
        rng: of the hand and of the images' noise.
    """
    keys = config.camera
    cameras = make_cameras(keys, rate_hz=config.rate_hz)
    if len(keys.clocks_s) > len(cameras):
        raise ConfigError("camera.clocks_s", f"has {len(keys.clocks_s)} values for {len(cameras)} cameras.")
    _check_renderer(keys)
    timeline = make_timeline(tosses, model, rng, start=START, carry=keys.carry_s, rest=keys.pause_s)
    apart = np.random.default_rng([config.seed, 5])  # without effects, images are as they were before there were any
    ids = frozenset(tag.id for tag in model.tags)
    settings = RenderSettings(
        samples=keys.samples,
        noise=keys.noise,
        blur=keys.blur,
        glare=keys.glare,
        aperture=keys.aperture_m,
        focus=keys.focus_m or keys.distance,
        texture=keys.texture,
        litter=scatter(keys.clutter, apart, area=keys.area, own_ids=ids),
    )
    hand, reaches = None, tuple[Reach, ...]()
    if keys.hand or keys.sweeps > 0:
        hand, reaches = hand_poses(
            timeline.t,
            timeline.q,
            lift=timeline.lift,
            release=timeline.release,
            rest=timeline.rest,
            holds=keys.hand,
            sweeps=keys.sweeps,
            cameras=cameras,
            rng=apart,
        )
    clocks = {camera.name: late for camera, late in zip(cameras, keys.clocks_s, strict=False)}
    filming = Filming(Shutter(keys.exposure_s, keys.line_s), clocks, keys.dropped, hand)
    renderer = None
    if keys.renderer == "mujoco":
        from tossid.vision.mujoco_render import MujocoRenderer

        renderer = MujocoRenderer(model, cameras, settings)
    inner = folder / "recording"  # the writer's own temporaries then lie inside ours
    with (
        RecordingWriter(inner, cameras, layout_of(model), quality=keys.quality) as writer,
        console.progress("render", len(timeline.t) * len(cameras), unit="images") as progress,
    ):
        truth = render_timeline(
            timeline,
            model,
            cameras,
            writer,
            rng,
            settings=settings,
            renderer=renderer,
            filming=filming,
            threads=os.cpu_count() or 1,
            progress=progress.advance,
        )
    for entry in inner.iterdir():
        entry.rename(folder / entry.name)
    inner.rmdir()
    write_tracks([PoseTrack("truth", timeline.t, timeline.q)], folder / TRUE_POSES)
    write_film_truth(folder, timeline, model, cameras, filming, settings, truth, reaches)
    return Filmed(timeline.tosses, truth.n_images, tuple(camera.name for camera in cameras))


def _check_renderer(keys: CameraConfig) -> None:
    """`ConfigError` where MuJoCo's renderer is asked for what only our own draws."""
    if keys.renderer == "mujoco":
        for name in ("line_s", "glare", "aperture_m", "texture", "clutter", "hand", "sweeps"):
            if getattr(keys, name):
                raise ConfigError(f"camera.{name}", "is not known to camera.renderer=mujoco; leave that at opencv.")


def write_film_truth(
    folder: Path,
    timeline: Timeline,
    model: ObjectModel,
    cameras: Sequence[Camera],
    filming: Filming,
    settings: RenderSettings,
    truth: FilmTruth,
    reaches: Sequence[Reach],
) -> None:
    """What a recording's images do not say themselves: `TRUE_FILM` and `TRUE_VIEWS`."""
    shutter = filming.shutter
    facts = {
        "schema": "tossid.film/1",
        "row_time": "true time of row r of h = stamp - clock_late_s + line_s * (r - (h - 1) / 2), mid-exposure [s]",
        "exposure_s": shutter.exposure,
        "line_s": shutter.line,
        "cameras": {
            camera.name: {
                "clock_late_s": filming.clocks.get(camera.name, 0.0),
                "rows": camera.resolution[1],
                "dropped_s": timeline.t[~truth.kept[:, c]].tolist(),
            }
            for c, camera in enumerate(cameras)
        },
        "effects": {
            "noise": settings.noise,
            "blur_px": settings.blur,
            "glare": settings.glare,
            "aperture_m": settings.aperture,
            "focus_m": settings.focus,
            "texture": settings.texture,
        },
        "hand": [asdict(reach) for reach in reaches],
        "clutter": [
            {"kind": o.kind, "tag_id": o.tag_id, "x_m": o.at[0], "y_m": o.at[1], "turn_rad": o.turn, "size_m": o.size}
            for o in settings.litter
        ],
    }
    (folder / TRUE_FILM).write_text(json.dumps(facts, indent=1) + "\n")
    np.savez_compressed(
        folder / TRUE_VIEWS,
        t=timeline.t,
        cameras=np.array([camera.name for camera in cameras]),
        tags=np.array([tag.id for tag in model.tags], dtype=np.int32),
        kept=truth.kept,
        visible=truth.visible.astype(np.float32),
    )


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
