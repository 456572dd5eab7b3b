"""The keys of every command, with their types and meanings.

`conf/COMMAND.yaml` names a command's default members, and holds what differs from the defaults here and in
`tossid.settings`. The text under a field is its
documentation; `tossid COMMAND --help` prints it. A field whose type is a
dataclass with a `name`, and that has a folder in `conf/`, is a group:
`source=tum` takes `conf/source/tum.yaml`. Where members differ in their keys,
the field is a union, or names a registry (`Registered`), and the member's `name`
picks the class.

Nothing heavy is imported here: help pages read this module.
"""

from __future__ import annotations

from pipelines.config.schemas.auditing import AuditConfig
from pipelines.config.schemas.diagnosis import DiagnoseConfig, MjcfSim, NominalSim, PythonSim, RunSim, Sim
from pipelines.config.schemas.ingestion import DetectStageConfig, IngestConfig, SegmentStageConfig, TrackStageConfig
from pipelines.config.schemas.launching import DaskLauncher, Launcher, ProcessesLauncher, SlurmLauncher
from pipelines.config.schemas.learning import EvaluateConfig, RegisterConfig, SweepConfig, TrainConfig
from pipelines.config.schemas.making import NewObjectConfig
from pipelines.config.schemas.synthesis import SynthesizeConfig
from pipelines.config.schemas.viewing import ExportConfig, ViewConfig
from tossid.settings.kinds import Bounds, Count, Fraction, NonNegative, Ordered, Positive, Range, Seed, Span

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
    "Count",
    "DaskLauncher",
    "DetectStageConfig",
    "DiagnoseConfig",
    "EvaluateConfig",
    "ExportConfig",
    "Fraction",
    "IngestConfig",
    "Launcher",
    "MjcfSim",
    "NewObjectConfig",
    "NominalSim",
    "NonNegative",
    "Ordered",
    "ProcessesLauncher",
    "Positive",
    "PythonSim",
    "Range",
    "RegisterConfig",
    "RunSim",
    "Seed",
    "SegmentStageConfig",
    "Sim",
    "SlurmLauncher",
    "Span",
    "SweepConfig",
    "SynthesizeConfig",
    "TrackStageConfig",
    "TrainConfig",
    "ViewConfig",
]
