"""Settings of evaluation and of export (`tossid.evaluation`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from tossid.settings.kinds import Count, Positive, advanced


@dataclass(frozen=True, kw_only=True)
class EvaluateSettings:
    """How rollouts are compared with tosses."""

    batch: Count = advanced(256)
    """tosses that are rolled out together; bounds the memory"""
    threads: Count = advanced(1)
    """threads of rollouts"""


@dataclass(frozen=True, kw_only=True)
class ExportSettings:
    """What is written."""

    format: Literal["mjcf", "urdf"] = "mjcf"
    """mjcf: a scene of the object on its ground, as it was learned; urdf: the object, with its meshes beside it"""
    timestep: Positive = 5e-4
    """MuJoCo's time step in the scene [s]"""
