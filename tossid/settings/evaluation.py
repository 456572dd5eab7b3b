"""Settings of evaluation and of export (`tossid.evaluation`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from tossid.settings.kinds import Count, Positive, Seed, advanced


@dataclass(frozen=True, kw_only=True)
class EvaluateSettings:
    """How rollouts are compared with tosses."""

    short_steps: Count = advanced(16)
    """steps of the short rollouts that tosses are also cut into"""
    draws: Count = advanced(2000)
    """sets of tosses that the bootstrap of a mean draws"""
    seed: Seed = advanced(0)
    """seed of the bootstrap"""
    batch: Count = advanced(256)
    """tosses that are rolled out together; bounds the memory"""
    threads: Count = advanced(1)
    """threads of rollouts"""


@dataclass(frozen=True, kw_only=True)
class ExportSettings:
    """What is written, and how MuJoCo's rollouts of it are compared with ours."""

    format: Literal["mjcf", "urdf"] = "mjcf"
    """mjcf: a scene of the object on its ground, as it was learned; urdf: the object, with its meshes beside it"""
    timestep: Positive = 5e-4
    """MuJoCo's time step in the scene [s]"""
    flights: Count = advanced(64)
    """starts of the comparison"""
    flight_s: Positive = advanced(0.5)
    """length of its rollouts [s]"""
    frame_s: Positive = advanced(1 / 148)
    """time between the frames that are compared [s]"""
    flight_step_s: Positive = advanced(1e-4)
    """MuJoCo's time step in free flight [s]"""
    substeps: Count = advanced(32)
    """our steps a frame: the comparison is of models, not of step lengths"""
    least_contact_steps: Positive = advanced(2.0)
    """time steps that the contact time, the root of compliance times mass, must span to be written as a spring"""
    seed: Seed = advanced(0)
    """seed of the starts"""
