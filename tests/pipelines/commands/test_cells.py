"""Keys of a study as cells: what identifies them."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipelines.commands.cells import study_cells
from pipelines.config.compose import load
from pipelines.config.schemas import EvaluateConfig
from tossid.errors import ConfigError
from tossid.studies import cells

SMALL = ["sweep.models=[cn,cnrp]", "sweep.values=[4.905,9.81]", "sweep.train=['epochs=2']", "data=tosses"]


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


def test_a_cell_has_the_settings_of_its_keys(made: Path) -> None:
    config = load("evaluate", EvaluateConfig, ["sweep=gravity", *SMALL])
    assert config.sweep is not None
    for cell, keys in study_cells(config.sweep, made / "tosses" / "tosses.h5", "a").items():
        assert cell.label == {"model": keys.model.name, "seed": keys.seed, "gravity": keys.model.gravity}
        assert (cell.settings.model, cell.settings.epochs) == (keys.model, 2)
        assert cell.keys["model"]["gravity"] == cell.value
