"""Keys of diagnose."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.settings.limits import Gravity


@dataclass(frozen=True)
class NominalSim:
    """The dataset's object as it is stated, in tossid's own rigid contact."""

    name: Literal["nominal"]
    """the stated object"""
    gravity: Gravity
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


@dataclass(frozen=True)
class PythonSim:
    """Your own simulator, a Python function f(q0, v0, n_steps, dt) -> (q, v); it runs in a process of its own."""

    name: Literal["python"]
    """a Python function"""
    path: Path
    """its file"""
    function: str
    """its name"""


Sim = NominalSim | RunSim | MjcfSim | PythonSim


@dataclass(frozen=True, kw_only=True)
class DiagnoseConfig(DiagnoseSettings):
    """Where a simulator differs from a dataset's tosses, which effect causes it, and how far that closes the gap."""

    sim: Sim
    """the simulator that is diagnosed:"""
    data: Path | None
    """the dataset; null: the newest"""
    out: Path | None
    """folder of the report; null: outputs/diagnose/DATASET-SIM"""
