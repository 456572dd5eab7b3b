"""`tossid evaluate` of a run: its metrics, its figures, and runs that it refuses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pipelines.cli import app
from pipelines.tracking.runs import find_run
from tests.pipelines.conftest import stored_run
from tossid.store import read_dataset


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


def test_copies_between_splits_are_said_once_by_train_and_once_by_evaluate(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    dataset = read_dataset(next(made.rglob("tosses.h5")))
    copy = replace(dataset.of_split("train")[0], name="copy", split="test")
    replace(dataset, tosses=(*dataset.tosses, copy), order=None).save(tmp_path / "leaks.h5")
    for command in (["train", "model=cn", "epochs=2", "data=leaks.h5"], ["evaluate"]):
        assert app.run([*command, "--quiet"]) == 0
        said = capfd.readouterr().err
        assert said.count("test tosses equal one of train") == 1
