"""The twenty demos: what a line says, and that a seed which has a line is not run again."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from experiments import demo_seeds
from experiments.demo_seeds import main, read_lines, row

LINE: dict[str, Any] = {
    "seed": 4,
    "row": ["friction mu", "0.18", "0.31", "0.3098 (0.3080 to 0.3120)"],
    "right": True,
    "holds": False,
    "brings": {"position_error_mm": {"before": 8.41, "after": 0.384}},
}


def test_a_line_becomes_a_row() -> None:
    assert row(LINE) == ["4", *LINE["row"], "yes", "no", "8.4 → 0.38 mm"]
    assert row(LINE | {"brings": None})[-1] == ""


def test_what_is_known_is_not_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    out = tmp_path / "demos.jsonl"
    out.write_text("".join(json.dumps(LINE | {"seed": seed, "right": seed == 4}) + "\n" for seed in (3, 4, 9)))
    before = out.read_text()
    monkeypatch.setattr(sys, "argv", ["demo_seeds", str(out), "--seeds", "3..4"])
    main()
    assert out.read_text() == before
    assert "1 of 2 demos" in capsys.readouterr().err
    assert [line["seed"] for line in read_lines(out)] == [3, 4, 9]
    assert demo_seeds.read_lines(tmp_path / "none") == []
