"""Which settings are varied, that lines are not computed twice, and what the table says."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pipelines.tools.experiments import sensitivity
from pipelines.tools.experiments.sensitivity import HALVED_AND_DOUBLED, brief, run, table, variants
from tests.diagnosis.tossed import seen
from tossid.diagnosis.findings import Interval
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.settings.changed import changed
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.store import Dataset


def test_ten_settings_are_halved_and_doubled() -> None:
    every = list(variants())
    assert len(HALVED_AND_DOUBLED) == 10
    assert len(every) == 21
    assert every[0] == {}
    assert every[1:3] == [{"likelihood.windows.length": 10}, {"likelihood.windows.length": 40}]
    assert {"selection.level": 0.1} in every
    assert all(changed(DiagnoseSettings(), keys) != DiagnoseSettings() for keys in every[1:])


@pytest.mark.slow
def test_what_is_there_is_not_computed_again(
    cube: ObjectModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tosses = seen(World(cube.with_changes(friction=0.3)), cube, 12, seed=4, frames=60)
    dataset, out = Dataset(cube, tuple(tosses), 148.0, "made", {}), tmp_path / "lines.jsonl"
    monkeypatch.setattr(sensitivity, "variants", lambda: iter([{}, {"selection.level": 0.1}]))
    out.write_text(json.dumps({"settings": {}}) + "\n")
    run(dataset, out, threads=1, repeats=0)
    _, line = (json.loads(each) for each in out.read_text().splitlines())
    assert line["settings"] == {"selection.level": 0.1}
    assert line["named"] == ["friction"]
    value, low, high = line["values"]["friction.mu"]
    assert low < value < high
    assert value == pytest.approx(0.3, abs=0.01)


def test_the_tables_have_a_row_for_each_line() -> None:
    shares = Interval(0.5, 0.4, 0.6).as_json()
    lines = [
        {
            "settings": {},
            "verdict": "no_gap",
            "named": [],
            "candidates": [],
            "values": {},
            "alternatives": {},
            "closed": shares,
        },
        {
            "verdict": "explained",
            "candidates": ["inertia"],
            "settings": {"selection.level": 0.1},
            "named": ["friction"],
            "values": {"friction.mu": [0.3, 0.29, 0.31], "inertia.scale_rel": [1.1, 1, 1.2]},
            "alternatives": {"friction": ["cohesion"]},
            "closed": shares,
        },
    ]
    rows = table(lines).splitlines()[2:]
    assert rows[0] == "| as it is |  | no_gap | nothing |  |  | 50 (40 to 60) |"
    assert rows[1] == (
        "| selection.level | 0.1 | explained | friction, (inertia) | friction: mu 0.3 (0.29 to 0.31); "
        "inertia: scale_rel 1.1 (1 to 1.2) | cohesion | 50 (40 to 60) |"
    )
    assert brief(lines).splitlines()[2:] == [
        "| as it is |  | no gap |  | 50 (40 to 60) |",
        "| selection.level | 0.1 | explained | **friction** 0.3; inertia 1.1 | 50 (40 to 60) |",
    ]
