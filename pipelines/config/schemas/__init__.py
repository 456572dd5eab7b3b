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
from pipelines.config.schemas.diagnosis import DiagnoseConfig
from pipelines.config.schemas.ingestion import DetectStageConfig, IngestConfig, SegmentStageConfig, TrackStageConfig
from pipelines.config.schemas.learning import EvaluateConfig, RegisterConfig, TrainConfig
from pipelines.config.schemas.making import NewObjectConfig
from pipelines.config.schemas.synthesis import SynthesizeConfig
from pipelines.config.schemas.viewing import ExportConfig, ViewConfig

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
