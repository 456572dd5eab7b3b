"""Judging folds beside a search that is repeated without each fold."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pipelines.tools.experiments import nested
from pipelines.tools.experiments.nested import compare, run, table
from tests.diagnosis.tossed import seen
from tossid.objects import ObjectModel
from tossid.physics.effects import World, effect_named
from tossid.store import Dataset, write_dataset


@pytest.mark.slow
def test_both_close_what_friction_makes(cube: ObjectModel) -> None:
    tosses = seen(World(cube.with_changes(friction=0.3)), cube, 16, seed=4, frames=60)
    found = compare(Dataset(cube, tuple(tosses), 148.0, "made", {}), [effect_named("friction")], folds=2)
    assert found["named"] == ["friction"]
    assert [each["named"] for each in found["exact"]] == [["friction"]] * 2
    assert sum(each["n_tosses"] for each in found["exact"]) == 16
    assert found["exact_closed"] > 0.7
    assert found["closed"]["value"] == pytest.approx(found["exact_closed"], abs=0.15)


def line_of(named: list[str], closed: float, exact: float) -> dict[str, Any]:
    shares = {"value": closed, "ci95": [closed - 0.1, closed + 0.1]}
    without = [{"named": each} for each in (named, ["wind"])]
    return {"tosses": 16, "named": named, "closed": shares, "exact_closed": exact, "exact": without, "cpu_s": 1.0}


def test_a_dataset_is_compared_once(cube: ObjectModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With as many tosses and the effects that were asked for; a fake comparison counts."""
    asked = []

    def counted(dataset: Dataset, library: list[Any], **keys: Any) -> dict[str, Any]:
        asked.append((len(dataset.tosses), [each.name for each in library], keys["folds"], keys["settings"].repeats))
        return line_of(["friction"], 0.9, 0.85)

    monkeypatch.setattr(nested, "compare", counted)
    write_dataset(
        Dataset(cube, tuple(seen(World(cube), cube, 3, seed=1, frames=30)), 148.0, "made", {}), tmp_path / "a.h5"
    )
    for tosses in ("2", "3", "2"):
        run([str(tmp_path / "a.h5")], tmp_path / "lines", {"tosses": tosses, "effects": "friction", "folds": "2"})
    assert asked == [(2, ["friction"], 2, 0), (3, ["friction"], 2, 0)]
    assert len((tmp_path / "lines").read_text().splitlines()) == 2


def test_the_table_says_how_far_shares_differ() -> None:
    """What is found nowhere does not count."""
    lines = [
        {"data": "a.h5", **line_of(["friction"], 0.9, 0.85)},
        {"data": "b.h5", **line_of(["wind"], 0.9, 0.7)},
        {"data": "c.h5", **line_of([], 0.0, 0.3)},
    ]
    first, second, third, _, summary = table(lines).splitlines()[2:]
    assert first == "| a.h5 | 16 | friction | friction; wind | 90 (80 to 100) | 85 |"
    assert "| wind | the same | 90 (80 to 100) | 70 |" in second
    assert "| nothing | nothing; wind | 0 (-10 to 10) | 30 |" in third
    assert summary.startswith("Something was found in 2 datasets. There judging folds say 12.5 points more")
    assert summary.endswith("within the interval in 1.")
