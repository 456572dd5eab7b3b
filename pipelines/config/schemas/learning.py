"""Keys of `train` and `evaluate`."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

from pipelines.config.schemas.launching import Launcher
from tossid.settings.evaluation import EvaluateSettings
from tossid.settings.kinds import Count, Positive, Seed, advanced
from tossid.settings.training import TrainSettings


@dataclass(frozen=True, kw_only=True)
class TrainConfig(TrainSettings):
    """Fit a model to a dataset."""

    data: Path | None
    """the dataset; null: the newest that ingest or synthesize wrote"""
    restart: bool
    """start anew where an interrupted training of the same keys and data could go on"""
    save_every_s: Positive = advanced(10.0)
    """longest time between two saves of a training in progress [s]; an interrupt saves too"""

    def settings(self) -> TrainSettings:
        """The library's part of the keys."""
        return TrainSettings(**{field.name: getattr(self, field.name) for field in fields(TrainSettings)})


@dataclass(frozen=True)
class SweepConfig:
    """A study: a training and its evaluation for each model, each value of a key and each seed."""

    name: str
    """what it is called; its results lie in outputs/sweeps"""
    key: str
    """the key of train that is swept; it takes numbers"""
    values: tuple[float, ...]
    """its values"""
    models: tuple[str, ...]
    """the models, of conf/model; one may carry keys of its own: 'cn optimizer=adam'"""
    seeds: tuple[Seed, ...]
    """the seeds"""
    train: tuple[str, ...]
    """further keys of every training, as KEY=VALUE"""
    workers: Count | None
    """processes: trainings at the same time; null: one a core"""


@dataclass(frozen=True, kw_only=True)
class EvaluateConfig(EvaluateSettings):
    """Roll a trained model out on held-out tosses, or run a study."""

    launcher: Launcher
    """a study: who computes its cells:"""
    sweep: SweepConfig | None
    """a study to run instead; '--sweep NAME' says the same:"""
    run: str | None
    """run id, name, folder, or models:/NAME/VERSION of the registry; null: the newest training"""
    data: Path | None
    """another dataset, of which all tosses are used; null: the held-out tosses of the run's own. A sweep: its dataset,
    else the newest"""


@dataclass(frozen=True)
class RegisterConfig:
    """A trained model under a name in MLflow's registry, as its next version."""

    name: str
    """the model's name; 'run=models:/NAME/VERSION' names it to other commands"""
    run: str | None
    """run id or name; null: the newest training"""
