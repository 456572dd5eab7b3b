"""Settings of `tossid.synthesize`: what simulates, how tosses begin, what is measured of them, how they are filmed."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from tossid.settings.kinds import (
    Bounds,
    Checked,
    Count,
    Fraction,
    NonNegative,
    Positive,
    Range,
    Seed,
    Span,
    advanced,
)
from tossid.settings.limits import Gravity
from tossid.settings.rendering import RenderSettings


@dataclass(frozen=True)
class LcpEngine:
    """tossid's own time stepping: rigid contact as a complementarity problem."""

    name: Literal["lcp"] = "lcp"
    """rigid contact"""
    substeps: Count = 4
    """time steps a frame"""
    directions: Annotated[int, Bounds(low=0)] = 0
    """0: the exact friction cone; 4, 6, 8, …: the polyhedral cone of so many directions"""
    impact_parts: Count = advanced(8)
    """parts of a time step in which contact gives way, where impacts have a duration"""


@dataclass(frozen=True)
class MujocoEngine:
    """MuJoCo, with contact as stiff as it bears, or as it is by default."""

    name: Literal["mujoco"] = "mujoco"
    """MuJoCo"""
    substeps: Count | None = None
    """time steps a frame; null: as many as its contact needs"""
    soft: bool = False
    """whether contact is as soft as MuJoCo has it by default, in place of near rigid"""


@dataclass(frozen=True)
class DrakeEngine:
    """Drake's multibody plant in discrete steps. `pip install 'tossid[engines]'`."""

    name: Literal["drake"] = "drake"
    """Drake"""
    substeps: Count = 128
    """time steps a frame"""
    radius: Positive = 1e-4
    """radius of the spheres at the corners [m]"""
    approximation: Literal["tamsi", "sap", "similar", "lagged"] = "tamsi"
    """Drake's approximation of contact in a step; its default, lagged, needs far shorter steps than tamsi"""


@dataclass(frozen=True)
class BulletEngine:
    """Bullet, by sequential impulses. `pip install 'tossid[engines]'`."""

    name: Literal["bullet"] = "bullet"
    """Bullet"""
    substeps: Count = 8
    """time steps a frame"""


Engine = LcpEngine | MujocoEngine | DrakeEngine | BulletEngine


@dataclass(frozen=True, kw_only=True)
class ReleaseSettings:
    """How tosses begin; each value is drawn between its two limits, the orientation from all."""

    height: Span = (0.1, 0.3)
    """lowest corner above the ground [m]"""
    landing: NonNegative = 0.12
    """radius of the disc about the origin in which it first comes down [m]"""
    speed: Span = (0.0, 1.0)
    """horizontal speed [m/s]"""
    climb: Range = (-0.5, 0.8)
    """vertical velocity, upward [m/s]"""
    spin: Span = (0.0, 8.0)
    """angular speed, about any axis [rad/s]"""
    joint: Range = (-1.5, 1.5)
    """joint angles, for an object with joints [rad]"""
    joint_rate: Range = (-2.0, 2.0)
    """joint rates [rad/s]"""


@dataclass(frozen=True, kw_only=True)
class NoiseSettings:
    """Standard deviations of what is added to the true states (frames=false)."""

    position: NonNegative = 0.0
    """of positions [m]"""
    rotation: NonNegative = 0.0
    """of orientations [rad]"""
    joint: NonNegative = 0.0
    """of joint angles [rad]"""
    velocity: NonNegative = 0.0
    """of velocities [m/s]"""
    spin: NonNegative = 0.0
    """of angular velocities [rad/s]"""
    joint_rate: NonNegative = 0.0
    """of joint rates [rad/s]"""


@dataclass(frozen=True, kw_only=True)
class CameraSettings(RenderSettings):
    """The cameras around the tosses, and what their images look like (frames=true)."""

    count: Annotated[int, Bounds(low=1, high=9)] = 3
    """how many"""
    width: Annotated[int, Bounds(low=64, high=8192)] = 640
    """image width [px]"""
    height: Annotated[int, Bounds(low=64, high=8192)] = 512
    """image height [px]"""
    exposure_s: NonNegative = 0.001
    """exposure [s]; motion blurs over it"""
    area: Positive = 1.0
    """diameter of the disc on the ground that every camera sees [m]"""
    elevation_deg: Annotated[float, Bounds(above=0, high=85)] = 38.0
    """over the ground [deg]"""
    distorted: bool = True
    """with lens distortion"""
    quality: Annotated[int, Bounds(low=30, high=100)] = 90
    """JPEG quality"""
    line_s: NonNegative = 0.0
    """rolling shutter: from one row's exposure to the next row's [s]; 0: all rows at once"""
    clocks_s: tuple[float, ...] = ()
    """how late each camera's clock is, in their order [s]; those left out are right"""
    dropped: Annotated[float, Bounds(low=0, high=0.9)] = 0.0
    """share of its frames that each camera loses"""
    clutter: Annotated[int, Bounds(low=0, high=200)] = 0
    """things on the ground that look like tags: strange tags, false codes, other families, chessboards, frames"""
    hand: bool = False
    """a hand holds the object until it is let go"""
    sweeps: Fraction = 0.0
    """share of the tosses in which a hand reaches through a camera's view"""
    carry_s: Span = (0.35, 0.5)
    """how long a hand carries the object to each release, between two limits [s]"""
    pause_s: Span = (0.15, 0.25)
    """how long the object lies before the hand takes it, between two limits [s]"""


@dataclass(frozen=True, kw_only=True)
class SynthesizeSettings(Checked):
    """World, engine, releases, noise and cameras of tosses that are made."""

    engine: Engine = MujocoEngine()
    """what simulates:"""
    tosses: Annotated[int, Bounds(low=1, high=10_000_000)] = 12
    """how many"""
    seed: Seed = 0
    """seed of everything random"""
    rate_hz: Annotated[float, Bounds(above=0, high=1e5)] = 148.0
    """frames a second"""
    gravity: Gravity = 9.81
    """downward [m/s²]"""
    effects: dict[str, dict[str, float]] = field(default_factory=dict)
    """what differs from the nominal world: {NAME: {PARAM: VALUE}}, of the library of effects, SI; others' nominal"""
    seconds: Annotated[float, Bounds(above=0, high=3600)] = 1.5
    """the longest that a toss may take [s]"""
    rest_s: NonNegative = 0.1
    """time at rest that ends a toss [s]"""
    splits: tuple[Fraction, Fraction, Fraction] = (0.5, 0.3, 0.2)
    """shares of tosses for train, validation and test (frames=false)"""
    release: ReleaseSettings = ReleaseSettings()
    """how tosses begin"""
    noise: NoiseSettings = NoiseSettings()
    """what is added to the states"""
    camera: CameraSettings = CameraSettings()
    """the cameras"""
