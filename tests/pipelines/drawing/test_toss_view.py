"""What is shown of datasets, runs and gaps is what they hold."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from pipelines.cli.console import Console
from pipelines.config.compose import load
from pipelines.config.schemas import ViewConfig
from pipelines.drawing.toss_view import in_a_row, toss_content
from tossid.errors import FileError
from tossid.motion import flight_frames
from tossid.objects import to_mjcf
from tossid.store import read_dataset


def test_tosses_and_rollouts_are_shown_one_after_another(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(made)
    dataset = read_dataset(made / "tosses" / "tosses.h5")
    row = in_a_row(dataset.tosses)
    assert all(a.t[-1] < b.t[0] for a, b in itertools.pairwise(row))
    np.testing.assert_allclose(np.diff(row[3].t), np.diff(dataset.tosses[3].t), atol=1e-12)
    everything = toss_content(load("view", ViewConfig, ["data=tosses"]), Console(quiet=True))
    assert len(everything.tosses) == len(dataset.tosses)
    assert sum(len(toss) for toss in dataset.tosses) == len(everything.moving[0].t)
    (run,) = (made / "outputs" / "train").glob("cnrpi-*")
    seen = toss_content(load("view", ViewConfig, [f"run={run}"]), Console(quiet=True))
    assert [toss.name for toss in seen.tosses] == [toss.name for toss in dataset.of_split("test")]
    measured, predicted = seen.moving[0], seen.predicted["predicted"][0]
    for toss in seen.tosses:  # a rollout starts where its toss does
        i, j = (int(np.argmin(np.abs(body.t - toss.t[0]))) for body in (measured, predicted))
        assert np.linalg.norm(measured.p[i] - predicted.p[j]) < 2e-3


def test_a_gap_is_shown_with_its_simulators(made: Path, tmp_path: Path) -> None:
    """Tosses of the stated object in rigid contact: both simulators follow them through their flight."""
    dataset = read_dataset(made / "tosses" / "tosses.h5")
    report = {
        "schema": "tossid.gap/1",
        "simulator": {"sim": "nominal", "about": "the stated cube"},
        "data": {"path": str(made / "tosses" / "tosses.h5")},
        "gap": {"total": {"value": 3.2, "unit": "standard deviations of noise"}},
        "explanation": {"verdict": "partly_explained"},
        "effects": [
            {
                "name": "friction",
                "verdict": "identified",
                "parameters": {"mu": {"value": 0.3}},
                "gap_closed": {"value": 0.8},
            },
            {"name": "wind", "verdict": "not_supported"},
        ],
        "patch": {"mjcf": to_mjcf(dataset.object, timestep=4e-4)},
    }
    (tmp_path / "gap.json").write_text(json.dumps(report))
    seen = toss_content(load("view", ViewConfig, [f"gap={tmp_path}"]), Console(quiet=True))
    assert "**partly explained**" in seen.notes
    assert "| friction | identified | mu 0.3 | 80 % |" in seen.notes
    assert "wind" not in seen.notes
    assert seen.predicted.keys() == {"stated", "patched"}
    (measured,) = seen.moving
    for (predicted,) in seen.predicted.values():
        assert len(predicted.t) == len(measured.t)
        for toss in seen.tosses:
            flight = (measured.t >= toss.t[0]) & (measured.t <= toss.t[flight_frames(toss, dataset.object) - 1])
            assert np.linalg.norm(predicted.p[flight] - measured.p[flight], axis=1).max() < 4e-3
    with pytest.raises(FileError, match="no gap report"):
        toss_content(load("view", ViewConfig, [f"gap={made / 'tosses'}"]), Console(quiet=True))
