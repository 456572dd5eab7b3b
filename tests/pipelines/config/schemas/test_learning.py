"""A training's keys hold the library's settings."""

from __future__ import annotations

from pipelines.config.compose import load
from pipelines.config.schemas import TrainConfig
from tossid.settings.training import TrainSettings


def test_the_librarys_part_of_the_keys() -> None:
    config = load("train", TrainConfig, ["seed=3", "epochs=7", "restart=true"])
    settings = config.settings()
    assert type(settings) is TrainSettings
    assert (settings.seed, settings.epochs) == (3, 7)
    assert settings.model == config.model
