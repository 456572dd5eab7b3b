"""Keys of diagnose."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pipelines.schemas.kinds import Bounds, Count, NonNegative, Seed


@dataclass(frozen=True)
class NominalSim:
    """The dataset's object as it is stated, in tossid's own rigid contact."""

    name: Literal["nominal"]
    """the stated object"""
    gravity: NonNegative
    """downward [m/s²]"""


@dataclass(frozen=True)
class RunSim:
    """A trained model: its object, gravity, residual and measurement."""

    name: Literal["run"]
    """a trained model"""
    path: str | None
    """run id, name or folder; null: the newest training"""


@dataclass(frozen=True)
class MjcfSim:
    """Your own MuJoCo model; what the diagnosis finds is also applied to it and rerun in MuJoCo."""

    name: Literal["mjcf"]
    """a MuJoCo model"""
    path: Path
    """its MJCF file: one free body, and the ground as a plane"""


Sim = NominalSim | RunSim | MjcfSim


@dataclass(frozen=True)
class DiagnoseConfig:
    """Where a simulator misses the tosses of a dataset, which effect causes it, and how far that closes the gap."""

    sim: Sim
    """the simulator that is judged:"""
    data: Path | None
    """the dataset; null: the newest"""
    split: Literal["train", "validation", "test"] | None
    """only the tosses of this split; null: all. Of others than the test split, rollouts of that are shown, too"""
    skip: Annotated[int, Bounds(low=0)]
    """how many tosses are left out before the first"""
    tosses: Count | None
    """how many tosses; null: all that follow"""
    out: Path | None
    """folder of the report; null: outputs/diagnose/DATASET-SIM"""
    seed: Seed
    """seed of the draws: which tosses fit and which judge, resampling"""
    without: tuple[str, ...]
    """effects of the library that are not considered"""
    threads: Count | None
    """threads of the simulator; null: one a core"""
