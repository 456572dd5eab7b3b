"""Keys of audit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pipelines.schemas.kinds import Bounds, Count, ObjectConfig, Ordered, Positive, Seed
from pipelines.schemas.launching import Launcher


@dataclass(frozen=True)
class AuditConfig:
    """Check diagnose on tosses whose effect is withheld from it, case by case; an interrupted audit goes on."""

    object: ObjectConfig
    """what is tossed"""
    cases: Count
    """how many cases; those of a smaller number are the first of them"""
    seed: Seed
    """seed of the cases"""
    out: Path | None
    """folder of the audit; null: outputs/audit/SEED"""
    data: Path | None
    """a dataset of real tosses: the simulator is spoilt instead, relative to what a first diagnosis finds"""
    tosses: Annotated[int, Bounds(low=6)]
    """tosses a case; of real ones so many are drawn"""
    engines: tuple[Literal["lcp", "mujoco"], ...]
    """what simulates, in turns; lcp alone where MuJoCo cannot express the effect"""
    position_noise: Positive
    """standard deviation of recorded positions [m]"""
    rotation_noise: Positive
    """standard deviation of recorded orientations [rad]"""
    displacement: Annotated[tuple[Positive, Positive], Ordered()]
    """how far an effect moves the object (median over a toss), over the position noise: drawn between these"""
    workers: Count | None
    """cases at the same time; null: one a core, or as many as the cluster has workers"""
    launcher: Launcher
    """who computes the cases:"""
