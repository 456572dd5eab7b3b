"""An input format that another package brings: its settings are keys, its file in conf/source is found."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipelines.cli import app
from tossid.store import write_tum
from tossid.store.importers.registry import FORMATS
from tossid.types import PoseTrack
from tossid.vision.recordings import registry

MODULE = '''
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tossid.settings.kinds import Positive
from tossid.store import read_tum
from tossid.store.importers.registry import Imported, register_importer


@dataclass(frozen=True, kw_only=True)
class SlowSource:
    """TUM files whose clock ran slow."""

    name: Literal["slow"] = "slow"
    """slow clocks"""
    path: Path
    """folder of NAME.txt files"""
    factor: Positive = 1.0
    """true seconds in a second of the files"""


def read(source, model):
    tracks = read_tum(source.path, n_joints=model.n_joints)
    return Imported([type(t)(t.name, t.t * source.factor, t.q) for t in tracks])


register_importer(SlowSource, read)
'''


@pytest.fixture
def plugin(project: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """An installed package with an entry point, and conf/source/slow.yaml in the working folder."""
    site = project / "site"
    (site / "slow_tosses-1.0.dist-info").mkdir(parents=True)
    (site / "slow_tosses-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: slow_tosses\n")
    (site / "slow_tosses-1.0.dist-info" / "entry_points.txt").write_text("[tossid.inputs]\nslow = slow_tosses\n")
    (site / "slow_tosses.py").write_text(MODULE)
    (project / "conf" / "source").mkdir(parents=True)
    (project / "conf" / "source" / "slow.yaml").write_text("name: slow\npath: ???\nfactor: 1.0\n")
    monkeypatch.syspath_prepend(str(site))
    registry._load_formats.cache_clear()
    yield
    FORMATS.pop("slow", None)
    registry._load_formats.cache_clear()


def test_a_plug_ins_format_is_a_member_of_source(
    plugin: None, project: Path, answer: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    t = np.arange(50) / 148  # a cube that falls for a third of a second, by the true clock
    q = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (50, 1))
    q[:, 2] = 0.7 - 0.5 * 9.81 * t**2
    write_tum(project / "slow", [PoseTrack(str(i), t / 1.02, q) for i in range(4)])
    made = answer("ingest", "source=slow", "source.path=slow", "source.factor=1.02", "out=a.h5")
    assert (made["source"], made["n_tosses"]) == ("slow", 4)
    assert made["rate_hz"] == pytest.approx(148.0)
    for key, says in (
        ("factor=-1", "source.factor: -1 is out of range"),
        ("rate_hz=1", "which has source.path, source"),
    ):
        assert app.run(["ingest", "source=slow", "source.path=slow", f"source.{key}"]) == 2
        assert says in capfd.readouterr().err
