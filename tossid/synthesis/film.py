"""Synthetic tosses as a recording of camera frames: a hand brings the object, lets go, it comes to rest; again."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from tossid.errors import ConfigError
from tossid.objects import ObjectModel
from tossid.settings.synthesis import CameraSettings, SynthesizeSettings
from tossid.synthesis.timeline import Filming, make_timeline, render_timeline
from tossid.types import PoseTrack, Toss
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import default_rig
from tossid.vision.cameras.shutter import Shutter
from tossid.vision.recordings.npz import write_tracks
from tossid.vision.recordings.writing import RecordingWriter
from tossid.vision.rendering.backdrop import scatter
from tossid.vision.rendering.hand import Reach, hand_poses
from tossid.vision.setup.layout import layout_of

START = 1.0
"""Time of the first frame [s]."""

TRUE_POSES = "truth_poses.npz"
"""The object's true pose in every frame, in the hand too."""
TRUE_FILM = "truth_film.json"
"""How it was filmed: the cameras' clocks, the times of an image's rows, lost frames, and what got in the way."""
TRUE_VIEWS = "truth_views.npz"
"""The share of each tag that each camera could see in each frame (n, cameras, tags)."""


def film(
    tosses: Sequence[Toss],
    model: ObjectModel,
    folder: Path,
    settings: SynthesizeSettings,
    *,
    rng: np.random.Generator,
    progress: Callable[[float], None] | None = None,
) -> tuple[Toss, ...]:
    """Render tosses into a recording, with what is true of it beside.

    Args:
        tosses: The true tosses.
        model: The object, with its tags.
        folder: An empty folder that becomes the recording.
        settings: Cameras, rate and seed.
        rng: Of the hand and of the images' noise.
        progress: Called with the share of the images that are rendered.

    Returns:
        The true tosses on the recording's clock.

    Raises:
        ConfigError: There are clocks for more cameras than there are.
        InputError: The exposure of an image's rows takes longer than a frame.
    """
    keys = settings.camera
    cameras = make_cameras(keys, rate_hz=settings.rate_hz)
    if len(keys.clocks_s) > len(cameras):
        raise ConfigError("camera.clocks_s", f"has {len(keys.clocks_s)} values for {len(cameras)} cameras.")
    timeline = make_timeline(tosses, model, rng, start=START, carry=keys.carry_s, rest=keys.pause_s)
    # a generator of their own: images without these effects do not depend on it
    apart = np.random.default_rng([settings.seed, 5])
    ids = frozenset(tag.id for tag in model.tags)
    images = replace(keys, litter=scatter(keys.clutter, apart, area=keys.area, own_ids=ids))
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
    done, total = 0, len(timeline.t) * len(cameras)

    def advance(count: int) -> None:
        nonlocal done
        done += count
        if progress is not None:
            progress(done / total)

    how: dict[str, Any] = {"settings": images, "filming": filming, "threads": os.cpu_count() or 1, "progress": advance}
    writer = RecordingWriter(folder, cameras, layout_of(model), quality=keys.quality)
    truth = render_timeline(timeline, model, cameras, writer, rng, **how)
    write_tracks([PoseTrack("truth", timeline.t, timeline.q)], folder / TRUE_POSES)
    facts = {
        "schema": "tossid.film/1",
        "row_time": "true time of row r of h = stamp - clock_late_s + line_s * (r - (h - 1) / 2), mid-exposure [s]",
        "exposure_s": keys.exposure_s,
        "line_s": keys.line_s,
        "cameras": {
            camera.name: {
                "clock_late_s": clocks.get(camera.name, 0.0),
                "rows": camera.resolution[1],
                "dropped_s": timeline.t[~truth.kept[:, c]].tolist(),
            }
            for c, camera in enumerate(cameras)
        },
        "effects": {
            "noise": images.noise,
            "blur_px": images.blur,
            "glare": images.glare,
            "aperture_m": images.aperture_m,
            "focus_m": images.lens[1],
            "texture": images.texture,
        },
        "hand": [asdict(reach) for reach in reaches],
        "clutter": [
            {"kind": o.kind, "tag_id": o.tag_id, "x_m": o.at[0], "y_m": o.at[1], "turn_rad": o.turn, "size_m": o.size}
            for o in images.litter
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
    return timeline.tosses


def make_cameras(settings: CameraSettings, *, rate_hz: float) -> tuple[Camera, ...]:
    """The cameras that the settings describe."""
    return default_rig(
        n_cameras=settings.count,
        resolution=(settings.width, settings.height),
        rate_hz=rate_hz,
        area=settings.area,
        distance=settings.distance,
        elevation_deg=settings.elevation_deg,
        distorted=settings.distorted,
    )
