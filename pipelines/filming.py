"""Synthetic tosses as camera frames: a hand brings the object, lets go, it comes to rest; again.

Frames lie on one clock. Before each release a hand moves the object from rest
to its release velocity at constant acceleration (so that the start of the free
flight has to be found); between a toss and the next no frames are taken.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipelines.console import Console
from pipelines.schemas import CameraConfig, SynthesizeConfig
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp, quat_mul
from tossid.store import write_tum
from tossid.types import Frame, PoseTrack, Toss
from tossid.vision.camera import Camera
from tossid.vision.recording import RecordingWriter
from tossid.vision.render import Renderer, RenderSettings
from tossid.vision.rig import default_rig
from tossid.vision.tagslam import layout_of

Array = NDArray[np.float64]

START = 1.0
"""Time of the first frame [s]."""

TRUE_POSES = "truth_poses"
"""Folder of the object's true poses in every frame, the hand's part too (TUM)."""


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
        tosses: true tosses, each from time 0.
        folder: an empty folder that becomes the recording.
        rng: of the images' noise; the same whatever the number of threads.
    """
    cameras = make_cameras(config.camera, rate_hz=config.rate_hz)
    settings = RenderSettings(samples=config.camera.samples, noise=config.camera.noise, blur=config.camera.blur)
    renderer = Renderer(model, cameras, settings)
    timed, tracks, speeds = _timeline(config, tosses)
    seed = int(rng.integers(2**62))
    inner = folder / "recording"
    n_images = sum(len(track.t) for track in tracks) * len(cameras)
    with (
        RecordingWriter(inner, cameras, layout_of(model), quality=config.camera.quality) as writer,
        console.progress("render", n_images, unit="images") as progress,
    ):

        def draw(camera: Camera, index: int, t: float, q: Array, v: Array) -> None:
            noise = np.random.default_rng([seed, index])
            half = 0.5 * config.camera.exposure_s
            image = renderer.render(moved(q, v, -half), moved(q, v, half), camera.name, noise)
            writer.write(Frame(camera.name, t, image))

        pool = ThreadPoolExecutor(max_workers=os.cpu_count())
        try:
            index = 0
            for track, v in zip(tracks, speeds, strict=True):
                jobs: list[Future[None]] = []
                for i in range(len(track.t)):
                    for camera in cameras:
                        jobs.append(pool.submit(draw, camera, index, float(track.t[i]), track.q[i], v[i]))
                        index += 1
                for job in jobs:
                    job.result()
                    progress.advance()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
    for entry in inner.iterdir():
        entry.rename(folder / entry.name)
    inner.rmdir()
    write_tum(folder / TRUE_POSES, tracks)
    return Filmed(tuple(timed), n_images, tuple(camera.name for camera in cameras))


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


def carried(q: Array, v: Array, tau: Array, duration: float) -> tuple[Array, Array]:
    """A hand's motion that ends in a release state.

    Velocity grows linearly from zero: v(τ) = v (1 + τ/T), so that the way still
    to go at τ is v (τ + τ²/2T).

    Args:
        q (nq,), v (nv,): the release state.
        tau: (n,) times before the release, -T <= τ < 0 [s].
        duration: T [s].

    Returns:
        q (n, nq), v (n, nv).
    """
    way = tau + tau**2 / (2 * duration)
    return moved(np.broadcast_to(q, (len(tau), len(q))), np.broadcast_to(v, (len(tau), len(v))), way), v * (
        1 + tau / duration
    )[:, None]


def moved(q: Array, v: Array, dt: float | Array) -> Array:
    """Configurations after moving with constant v for dt [s]. (*b, nq), (*b, nv), (*b) -> (*b, nq)."""
    dt = np.asarray(dt, dtype=float)[..., None]
    return np.concatenate(
        [
            q[..., :3] + dt * v[..., :3],
            quat_mul(q[..., 3:7], quat_exp(dt * v[..., 3:6])),
            q[..., 7:] + dt * v[..., 6:],
        ],
        axis=-1,
    )


def _timeline(config: SynthesizeConfig, tosses: Sequence[Toss]) -> tuple[list[Toss], list[PoseTrack], list[Array]]:
    """Tosses and whole tracks (with the hand's part) on one clock, and the tracks' velocities."""
    dt = 1.0 / config.rate_hz
    n_carry = round(config.camera.carry_s * config.rate_hz)
    n_gap = max(1, round(config.camera.gap_s * config.rate_hz))
    timed, tracks, speeds = [], [], []
    first = round(START * config.rate_hz)
    for toss in tosses:
        n = n_carry + len(toss)
        t = np.round((first + np.arange(n)) * dt, 9)
        q, v = toss.q, toss.v
        if n_carry:
            tau: Array = -dt * np.arange(n_carry, 0, -1, dtype=float)
            q_hand, v_hand = carried(toss.q[0], toss.v[0], tau, n_carry * dt)
            q, v = np.concatenate([q_hand, q]), np.concatenate([v_hand, v])
        timed.append(replace(toss, t=t[n_carry:]))
        tracks.append(PoseTrack(toss.name, t, q))
        speeds.append(v)
        first += n + n_gap
    return timed, tracks, speeds
