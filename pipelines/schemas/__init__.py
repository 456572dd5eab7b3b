"""What every command can be told: the type and the meaning of each key.

Values live in `conf/`: none has a default here. The text under a field is its
documentation; `tossid COMMAND --help` prints it. A field whose type is a
dataclass with a `name`, and that has a folder in `conf/`, is a group:
`source=tum` takes `conf/source/tum.yaml`. Where members differ in their keys,
the field is a union, and the member's `name` picks the class.

Nothing heavy is imported here: help pages read this module.
"""

from __future__ import annotations

from pipelines.schemas.auditing import AuditConfig
from pipelines.schemas.diagnosis import DiagnoseConfig, MjcfSim, NominalSim, RunSim, Sim
from pipelines.schemas.ingestion import (
    ContactNetsSource,
    DetectConfig,
    DetectStageConfig,
    FramesSource,
    IngestConfig,
    PllSource,
    RosbagSource,
    SegmentConfig,
    SegmentStageConfig,
    Source,
    TrackConfig,
    TrackStageConfig,
    TumSource,
    VideoSource,
)
from pipelines.schemas.kinds import (
    Bounds,
    Count,
    Fraction,
    NonNegative,
    ObjectConfig,
    Ordered,
    Positive,
    Range,
    Seed,
    Span,
)
from pipelines.schemas.launching import DaskLauncher, Launcher, ProcessesLauncher, SlurmLauncher
from pipelines.schemas.learning import EvaluateConfig, ModelConfig, RegisterConfig, SweepConfig, TrainConfig
from pipelines.schemas.making import NewObjectConfig
from pipelines.schemas.synthesis import (
    CameraConfig,
    Engine,
    LcpEngine,
    MujocoEngine,
    NoiseConfig,
    ReleaseConfig,
    SynthesizeConfig,
)
from pipelines.schemas.viewing import ExportConfig, ViewConfig

COMMANDS: dict[str, type] = {
    "audit": AuditConfig,
    "detect": DetectStageConfig,
    "diagnose": DiagnoseConfig,
    "evaluate": EvaluateConfig,
    "export": ExportConfig,
    "ingest": IngestConfig,
    "new-object": NewObjectConfig,
    "register": RegisterConfig,
    "segment": SegmentStageConfig,
    "synthesize": SynthesizeConfig,
    "track": TrackStageConfig,
    "train": TrainConfig,
    "view": ViewConfig,
}
"""The schema of each command that takes keys."""

__all__ = [
    "AuditConfig",
    "Bounds",
    "COMMANDS",
    "CameraConfig",
    "ContactNetsSource",
    "Count",
    "DaskLauncher",
    "DetectConfig",
    "DetectStageConfig",
    "DiagnoseConfig",
    "Engine",
    "EvaluateConfig",
    "ExportConfig",
    "Fraction",
    "FramesSource",
    "IngestConfig",
    "Launcher",
    "LcpEngine",
    "MjcfSim",
    "ModelConfig",
    "MujocoEngine",
    "NewObjectConfig",
    "NoiseConfig",
    "NominalSim",
    "NonNegative",
    "ObjectConfig",
    "Ordered",
    "PllSource",
    "ProcessesLauncher",
    "RosbagSource",
    "Positive",
    "Range",
    "RegisterConfig",
    "ReleaseConfig",
    "RunSim",
    "Seed",
    "SegmentConfig",
    "SegmentStageConfig",
    "Sim",
    "SlurmLauncher",
    "Source",
    "Span",
    "SweepConfig",
    "SynthesizeConfig",
    "TrackConfig",
    "TrackStageConfig",
    "TrainConfig",
    "TumSource",
    "VideoSource",
    "ViewConfig",
]
