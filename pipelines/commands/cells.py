"""Keys of a study as cells of the library."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pipelines.config.compose import as_plain, load
from pipelines.config.schemas.learning import SweepConfig, TrainConfig
from tossid.errors import ConfigError
from tossid.settings.changed import changed
from tossid.studies.cells import StudyCell, study_cell

_OWN = ("data", "restart", "model", "seed")
"""Keys of train that a study sets itself."""


def study_cells(sweep: SweepConfig, data: Path, sha256: str) -> dict[StudyCell, TrainConfig]:
    """The cells of a study with the keys of their trainings, in the order models, values, seeds.

    Args:
        sweep: The study's keys.
        data: The dataset.
        sha256: Of the dataset.

    Raises:
        ConfigError: Nothing is swept, or `tossid train` would refuse a key.
    """
    _check(sweep)
    cells = {}
    for model in sweep.models:
        first = f"{sweep.key}={_number(sweep.values[0])}"
        name, *keys = model.split()
        base = replace(load("train", TrainConfig, [f"model={name}", first, *sweep.train, *keys]), data=data)
        for value in sweep.values:
            for seed in sweep.seeds:
                config = changed(base, {sweep.key: _number(value), "seed": seed})
                cell = study_cell(model, sweep.key, value, config.settings(), sha256, keys=as_plain(config))
                cells[cell] = config
    return cells


def _check(sweep: SweepConfig) -> None:
    for name in ("values", "models", "seeds"):
        if not getattr(sweep, name):
            raise ConfigError(f"sweep.{name}", "is empty; a study needs at least one.")
        if len(set(getattr(sweep, name))) < len(getattr(sweep, name)):
            raise ConfigError(f"sweep.{name}", "names one twice.")
    own = [text for model in sweep.models for text in model.split()[1:]]
    for where, texts in (("sweep.train", sweep.train), ("sweep.key", [f"{sweep.key}="]), ("sweep.models", own)):
        for text in texts:
            if text.partition("=")[0] in _OWN:
                raise ConfigError(where, f"{text.partition('=')[0]} is set by the study itself.")


def _number(value: float) -> int | float:
    return int(value) if value.is_integer() else value
