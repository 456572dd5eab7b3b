"""Intervals of an audit beside the scatter of its repeats."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pipelines.tools.experiments.simulated.scatter import compared, table


def written(folder: Path, values: list[float], true: float) -> None:
    """A case whose friction is found as 0.30 (0.29 to 0.31), with repeats that found these values."""
    folder.mkdir(parents=True)
    repeated = [{"effects": {"friction": {"mu": x}}, "closed": 0.9} for x in values]
    gap = {
        "explanation": {"repeated": repeated, "hypothesis": {"friction": {"mu": 0.3}}},
        "effects": [{"name": "friction", "saturated": False}],
    }
    parameter = {"effect": "friction", "name": "mu", "true": true, "value": 0.3, "ci95": [0.29, 0.31]}
    score = {"parameters": [{**parameter, "covered": 0.29 <= true <= 0.31}]}
    (folder / "gap.json").write_text(json.dumps(gap))
    (folder / "result.json").write_text(json.dumps({"score": score}))


def test_what_scatters_beyond_its_interval_is_widened(tmp_path: Path) -> None:
    written(tmp_path / "cases" / "000", [0.30, 0.301, 0.299, 0.30, 0.30], 0.305)
    written(tmp_path / "cases" / "001", [0.26, 0.34, 0.26, 0.34, 0.30], 0.33)
    written(tmp_path / "cases" / "002", [0.3, 0.3, 0.3, 0.3], 0.3)  # too few
    near, far = compared(tmp_path)
    assert (near.covers, near.covers_widened) == (True, True)
    assert near.ratio == pytest.approx(1.96 * 0.0007071 / 0.01, rel=1e-3)
    assert (far.covers, far.covers_widened) == (False, True)
    assert "1 of 2 values scatter beyond" in table([near, far])
    assert "1 of 2 intervals hold, and 2 if" in table([near, far])
    assert table([]).count("\n") == 1
