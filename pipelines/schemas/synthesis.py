"""Keys of synthesize."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pipelines.schemas.kinds import (
    Bounds,
    Count,
    Fraction,
    NonNegative,
    ObjectConfig,
    Positive,
    Range,
    Seed,
    Span,
)


@dataclass(frozen=True)
class LcpEngine:
    """tossid's own time stepping: rigid contact as a complementarity problem."""

    name: Literal["lcp"]
    """rigid contact"""
    substeps: Count
    """time steps a frame"""
    directions: Annotated[int, Bounds(low=0)]
    """0: the exact friction cone; 4, 6, 8, …: the polyhedral cone of so many directions"""


@dataclass(frozen=True)
class MujocoEngine:
    """MuJoCo, with contact as stiff as it bears."""

    name: Literal["mujoco"]
    """MuJoCo"""
    substeps: Count | None
    """time steps a frame; null: as many as its contact needs to be near rigid"""


Engine = LcpEngine | MujocoEngine


@dataclass(frozen=True)
class ReleaseConfig:
    """How tosses begin; each value is drawn between its two limits, the orientation from all."""

    height: Span
    """lowest corner above the ground [m]"""
    landing: NonNegative
    """radius of the disc about the origin in which it first comes down [m]"""
    speed: Span
    """horizontal speed [m/s]"""
    climb: Range
    """vertical velocity, upward [m/s]"""
    spin: Span
    """angular speed, about any axis [rad/s]"""
    joint: Range
    """joint angles, for an object with joints [rad]"""
    joint_rate: Range
    """joint rates [rad/s]"""


@dataclass(frozen=True)
class NoiseConfig:
    """Standard deviations of what is added to the true states (frames=false)."""

    position: NonNegative
    """of positions [m]"""
    rotation: NonNegative
    """of orientations [rad]"""
    joint: NonNegative
    """of joint angles [rad]"""
    velocity: NonNegative
    """of velocities [m/s]"""
    spin: NonNegative
    """of angular velocities [rad/s]"""
    joint_rate: NonNegative
    """of joint rates [rad/s]"""


@dataclass(frozen=True)
class CameraConfig:
    """The cameras around the tosses, and what their images look like (frames=true)."""

    renderer: Literal["opencv", "mujoco"]
    """opencv needs nothing of the system; mujoco needs EGL or OSMesa"""
    count: Annotated[int, Bounds(low=1, high=9)]
    """how many"""
    width: Annotated[int, Bounds(low=64, high=8192)]
    """image width [px]"""
    height: Annotated[int, Bounds(low=64, high=8192)]
    """image height [px]"""
    exposure_s: NonNegative
    """exposure [s]; motion blurs over it"""
    area: Positive
    """diameter of the disc on the ground that every camera sees [m]"""
    distance: Positive
    """from the middle of the area [m]"""
    elevation_deg: Annotated[float, Bounds(above=0, high=85)]
    """over the ground [deg]"""
    distorted: bool
    """with lens distortion"""
    samples: Count
    """rays a pixel"""
    noise: NonNegative
    """sensor noise [grey levels]"""
    blur: NonNegative
    """lens blur [px]"""
    quality: Annotated[int, Bounds(low=30, high=100)]
    """JPEG quality"""
    line_s: NonNegative
    """rolling shutter: from one row's exposure to the next row's [s]; 0: all rows at once"""
    clocks_s: tuple[float, ...]
    """how late each camera's clock is, in their order [s]; those left out are right"""
    dropped: Annotated[float, Bounds(low=0, high=0.9)]
    """share of its frames that each camera loses"""
    glare: NonNegative
    """brightness of the lamp's mirror image on faces with tags; 1: as bright as white paper"""
    aperture_m: NonNegative
    """diameter of the lens's opening, which blurs what is out of focus [m]; 0: all is sharp"""
    focus_m: Positive | None
    """distance in focus [m]; null: camera.distance"""
    texture: NonNegative
    """contrast of the ground's pattern [grey levels]"""
    clutter: Annotated[int, Bounds(low=0, high=200)]
    """things on the ground that look like tags: strange tags, false codes, other families, chessboards, frames"""
    hand: bool
    """a hand holds the object until it is let go"""
    sweeps: Fraction
    """share of the tosses in which a hand reaches through a camera's view"""
    carry_s: Span
    """how long a hand carries the object to each release, between two limits [s]"""
    pause_s: Span
    """how long the object lies before the hand takes it, between two limits [s]"""


@dataclass(frozen=True)
class SynthesizeConfig:
    """Keys of `tossid synthesize`."""

    object: ObjectConfig
    """what is tossed:"""
    engine: Engine
    """what simulates:"""
    tosses: Count
    """how many"""
    frames: bool
    """camera frames (a recording for ingest), or states (a dataset for train)"""
    seed: Seed
    """seed of everything random"""
    rate_hz: Positive
    """frames a second"""
    gravity: NonNegative
    """downward [m/s²]"""
    effects: dict[str, dict[str, float]]
    """what differs from the nominal world: {NAME: {PARAM: VALUE}}, of the library of effects, SI; others' nominal"""
    seconds: Positive
    """the longest that a toss may take [s]"""
    rest_s: NonNegative
    """time at rest that ends a toss [s]"""
    out: Path | None
    """folder to write; null: data/raw/OBJECT-ENGINE-SEED"""
    splits: tuple[Fraction, Fraction, Fraction]
    """shares of tosses for train, validation and test (frames=false)"""
    release: ReleaseConfig
    """how tosses begin"""
    noise: NoiseConfig
    """what is added to the states"""
    camera: CameraConfig
    """the cameras"""
