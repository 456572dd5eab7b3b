"""`make experiments`: every study is there, and what is made already is taken as it is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from experiments import cube as experiments
from pipelines.config.compose import load
from pipelines.config.schemas import COMMANDS

Call = tuple[str, list[str]]


@pytest.fixture
def called(project: Path, monkeypatch: pytest.MonkeyPatch) -> list[Call]:
    """The commands that are given, each with keys that it takes; they write an empty dataset."""
    calls: list[Call] = []

    def take(command: str, keys: list[str], *, json: bool, quiet: bool) -> None:
        config: Any = load(command, COMMANDS[command], keys)
        calls.append((command, keys))
        if command == "evaluate":
            assert config.sweep.name in dict(calls_of_studies())
            return
        path = project / config.out
        path = path / "tosses.h5" if command == "synthesize" else path
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()

    monkeypatch.setattr(experiments, "call_with_keys", take)
    return calls


def calls_of_studies() -> list[tuple[str, str]]:
    return [(study, dataset) for dataset, study in experiments.STUDIES]


def test_datasets_are_made_once_and_every_study_is_called(project: Path, called: list[Call]) -> None:
    for name in experiments.RECORDED:
        (project / "recordings" / name).mkdir(parents=True)
    experiments.main(project / "recordings")
    made = len(experiments.RECORDED) + len(experiments.SIMULATED)
    commands = [command for command, _ in called]
    assert sorted(commands[:made]) == ["ingest"] * len(experiments.RECORDED) + ["synthesize"] * len(
        experiments.SIMULATED
    )
    assert commands[made:] == ["evaluate"] * len(experiments.STUDIES)
    for (dataset, study), (_, keys) in zip(experiments.STUDIES, called[made:], strict=True):
        assert keys[0] == f"sweep={study}"
        assert dataset in keys[1]
        assert Path(keys[1].removeprefix("data=")).is_file()
    first = called[made:]
    called.clear()
    experiments.main(project / "nowhere")
    assert called == first
