"""Where trainings end that begin elsewhere, and the file in which a study's cases are kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments import starts
from experiments.harness import measured, options
from tests.models.made import tosses
from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.store import Dataset, draw_splits


def test_ends_are_compared_both_ways_over_what_was_seen(cube: ObjectModel) -> None:
    def end(corners: np.ndarray, seen: list[bool]) -> dict[str, Any]:
        return {"vertices": corners.tolist(), "seen": seen, "friction": 0.18, "position": 10.0}

    whole, fewer = end(cube.corner_pos, [True] * 8), end(cube.corner_pos[:7], [True] * 7)
    assert starts.apart(whole, whole) == (0.0, 0.0)
    assert starts.apart(fewer, whole) == pytest.approx((cube.width, 0.0))
    assert starts.apart(whole, fewer) == pytest.approx((0.0, cube.width))
    moved = cube.corner_pos.copy()
    moved[0] += 0.05
    assert starts.apart(end(moved, [False] + [True] * 7), whole) == pytest.approx((cube.width, 0.0))
    assert starts.apart(end(np.vstack([cube.corner_pos, np.zeros((1, 3))]), [True] * 8 + [False]), whole) == (0, 0)
    assert starts.same_end(whole, {**whole, "position": 10.2})
    for other in ({"position": 10.4}, {"friction": 0.2}):
        assert not starts.same_end(whole, {**whole, **other})


@pytest.mark.slow
def test_rows_say_where_a_start_ended(
    cube: ObjectModel, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    made = draw_splits(tuple(tosses(cube, 40, seed=3)), fractions=(0.7, 0.15, 0.15), seed=0)
    dataset = Dataset(cube, made, 148.0, "synthetic", {})
    monkeypatch.setattr(starts, "cube", lambda folder: replace(dataset))
    starts.main([str(tmp_path / "out.jsonl"), ".", "--models", "cn", "--tosses", "20", "--random", "2", "--nothing"])
    lines = capsys.readouterr().out.splitlines()
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines if line.startswith("| `cn`")]
    found = {row[starts.HEADS.index("start")]: dict(zip(starts.HEADS, row, strict=True)) for row in rows}
    assert list(found) == ["stated", "nothing", "0", "1"]
    # rollouts of tosses without noise miss by 1 %, of which 3 % decide nothing
    for start in ("stated", "0", "1"):
        assert all(float(each) < starts.CORNERS_MM for each in found[start]["missed, beyond [mm]"].split(", "))
    assert lines[-1].split()[1:3] == ["of", "3"]


def test_a_study_goes_on_where_it_was(tmp_path: Path) -> None:
    calls: list[int] = []

    def square(case: Any) -> dict[str, Any]:
        calls.append(case["x"])
        if case["x"] == 3:
            raise InputError("three is refused")
        return {"y": case["x"] ** 2}

    out = tmp_path / "new" / "lines.jsonl"
    assert measured(out, [{"x": 1}, {"x": 3}], square)[0] == {"x": 1, "y": 1}
    lines = measured(out, [{"x": x} for x in (2, 1, 3)], square)
    assert calls == [1, 3, 2]
    assert lines[:2] == [{"x": 2, "y": 4}, {"x": 1, "y": 1}]
    assert "three is refused" in lines[2]["failed"]


def test_options_are_read_by_their_defaults() -> None:
    words = ["lines.jsonl", "--cases", "a", "b", "--seed", "3", "--judged"]
    given = options("", words, out=Path, cases=("x",), seed=0, judged=False, share=0.5)
    assert vars(given) == {
        "out": Path("lines.jsonl"), "cases": ["a", "b"], "seed": 3, "judged": True, "share": 0.5,
    }  # fmt: skip
