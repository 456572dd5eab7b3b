"""Cells of a study: what identifies them, and that processes compute what one does."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from pipelines.commands import cells
from pipelines.commands.cells import compute, compute_all, study_cells
from pipelines.config.compose import load
from pipelines.config.schemas import EvaluateConfig
from tossid.errors import ConfigError
from tossid.store import file_sha256, read_dataset

SMALL = ["sweep.models=[cn,cnrp]", "sweep.values=[4.905,9.81]", "sweep.train=['epochs=2']", "data=tosses"]


def test_processes_give_the_numbers_of_one(beside: Path) -> None:
    data = beside / "tosses" / "tosses.h5"
    config = load("evaluate", EvaluateConfig, ["sweep=gravity", *SMALL])
    assert config.sweep is not None
    sha256 = file_sha256(data)
    dataset, study = read_dataset(data), study_cells(config.sweep, data, sha256)
    before = dict(os.environ)
    apart = dict(compute_all(study[1:3], sha256=sha256, workers=2, launcher=config.launcher))
    assert dict(os.environ) == before
    for cell in study[1:3]:
        here, there = compute(dataset, cell.config), apart[cell]
        assert isinstance(there, cells.Computed)
        assert {**there.result, "seconds": 0} == {**here.result, "seconds": 0}
        losses = [[row["train_loss"] for row in one.history] for one in (here, there)]
        assert losses[0] == losses[1]


def test_cells_are_told_apart_by_what_they_depend_on(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = made / "tosses" / "tosses.h5"

    def digests(*keys: str, sha256: str = "a") -> list[str]:
        config = load("evaluate", EvaluateConfig, ["sweep=gravity", *keys])
        assert config.sweep is not None
        return [cell.digest for cell in study_cells(config.sweep, data, sha256)]

    one = digests(*SMALL)
    assert len(set(one)) == 4
    assert digests(*SMALL, "sweep.name=other", "sweep.workers=3") == one
    for other in (digests(*SMALL, sha256="b"), digests(*SMALL, "sweep.seeds=[1]")):
        assert not set(other) & set(one)
    monkeypatch.setattr(cells, "code_digest", lambda *modules: "changed")
    assert not set(digests(*SMALL)) & set(one)
    with pytest.raises(ConfigError, match="names one twice"):
        digests("sweep.seeds=[1,1]")
