"""A training is timed by its stages, and judged on held-out tosses."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import bench_studies
from benchmarks.bench_studies import HEADS, SCORES, trainings
from tossid import synthesize, write_dataset


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
