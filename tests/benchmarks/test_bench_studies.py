"""A training is timed by its stages, and judged on held-out tosses."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import bench_studies
from benchmarks.bench_studies import HEADS, SCORES, trainings
from tossid import synthesize, write_dataset
from tossid.errors import ConfigError


class Kept:
    """A console that keeps what it is given."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.tables: list[tuple[tuple[str, ...], list[list[str]]]] = []

    def say(self, line: str) -> None:
        self.said.append(line)

    def table(self, heads: tuple[str, ...], rows: list[list[str]], title: str) -> None:
        self.tables.append((heads, rows))


def test_a_training_is_timed_by_stage_and_judged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "tosses.h5"
    write_dataset(synthesize("cube", engine="lcp", tosses=8, seconds=0.5), file)
    monkeypatch.setattr(bench_studies, "CUBE", file)
    trainings(console := Kept(), models=("cn",))  # type: ignore[arg-type]
    (heads, stages), (score_heads, scores) = console.tables
    assert (heads, score_heads) == (HEADS, SCORES)
    assert [row[2] for row in stages][:2] == ["read", "prepare"]
    assert [row[2] for row in stages][-2:] == ["intervals", "evaluate"]
    assert any("contact" in row[2] for row in stages)
    assert all(len(row) == len(HEADS) for row in stages)
    assert [row[0] for row in scores] == ["cn"]
    assert float(scores[0][-1]) == pytest.approx(0.18, abs=0.1)


def test_what_is_missing_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_studies, "CUBE", tmp_path / "none.h5")
    trainings(console := Kept())  # type: ignore[arg-type]
    assert console.tables == []
    assert "none.h5 is missing" in console.said[0]


def test_a_gravity_that_is_no_number_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["bench_studies", "cn", "cnrpi"])
    with pytest.raises(ConfigError, match="'cnrpi' is no number"):
        bench_studies.main()


def test_a_training_from_nothing_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[dict[str, object]] = []
    monkeypatch.setattr(bench_studies, "trainings", lambda _, **keys: asked.append(keys))
    for words in (["--unknown", "cnrpi"], ["cn", "0"]):
        monkeypatch.setattr("sys.argv", ["bench_studies", *words])
        bench_studies.main()
    assert asked == [
        {"models": ("cnrpi",), "gravities": [9.81], "unknown": True},
        {"models": ("cn",), "gravities": [0.0], "unknown": False},
    ]
