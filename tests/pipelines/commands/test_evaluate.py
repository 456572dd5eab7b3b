"""`tossid evaluate` of a run: its metrics, its figures, and runs that it refuses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pipelines.tracking.runs import find_run
from tests.pipelines.conftest import stored_run


def test_a_run_is_found_by_its_folder_and_judged_on_held_out_tosses(
    made: Path, answer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(made)
    (folder,) = made.glob("outputs/train/*")
    by_folder = answer("evaluate", f"run={folder.relative_to(made)}")
    assert by_folder["run"] == find_run(command="train").id
    assert by_folder["n_tosses"] == 2
    for path in by_folder["figures"]:
        assert Path(path).read_bytes()[:4] in (b"\x89PNG", b"GIF8")
    names = {Path(path).stem for path in by_folder["figures"]}
    assert {"errors_over_tosses", "toss_comparison_median", "toss_comparison_worst", "residual_over_toss"} <= names
    judged = find_run(command="evaluate")
    assert {path.stem for path in (judged.folder / "figures").iterdir()} == names
    assert stored_run(judged.id).data.metrics["position_error_pct"] == pytest.approx(
        by_folder["position_error_pct"]["mean"]
    )
