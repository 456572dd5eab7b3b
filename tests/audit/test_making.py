"""A case's tosses come through files of poses or a film, and nothing that the diagnosis gets names the effect."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tossid.audit.cases import Case
from tossid.audit.making import make_case
from tossid.objects import load_object
from tossid.settings.audit import AuditSettings
from tossid.store import read_dataset

SETTINGS = AuditSettings(tosses=6)


def test_what_the_diagnosis_gets_came_through_tum_files_and_does_not_name_the_effect(tmp_path: Path) -> None:
    case = Case(3, "effect", "lcp", ("linear_drag",), (40.0,), 11)
    truth = make_case(case, load_object("cube"), SETTINGS, tmp_path)
    assert truth["effects"]["linear_drag"]["c_nspm"] > 0
    assert 30 < truth["displacement"]["linear_drag"] < 55
    assert len(list((tmp_path / "tum").glob("*.txt"))) == 6
    dataset = read_dataset(tmp_path / "tosses.h5")
    assert dataset.source == "tum"
    assert all(toss.q_cov[5, 0, 0] > 1e-9 for toss in dataset.tosses)  # noise as it is estimated from the poses
    everything = b"".join(path.read_bytes() for path in tmp_path.rglob("*") if path.is_file())
    assert b"linear_drag" not in everything
    assert b"c_nspm" not in everything


@pytest.mark.slow  # three cameras film six tosses, a minute
def test_filmed_tosses_are_tracked_and_the_film_does_not_stay(tmp_path: Path) -> None:
    case = Case(3, "effect", "lcp", ("linear_drag",), (40.0,), 11)
    make_case(case, load_object("cube"), replace(SETTINGS, filmed=True), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["tosses.h5"]
    dataset = read_dataset(tmp_path / "tosses.h5")
    assert dataset.source == "frames"
    assert len(dataset.tosses) == 6
    assert b"linear_drag" not in (tmp_path / "tosses.h5").read_bytes()


def test_a_force_outside_the_library_moves_the_tosses(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("with", "without")]
    for folder, case in zip(
        folders,
        (Case(0, "outside", "lcp", ("pulsing_force",), (60.0,), 5), Case(0, "null", "lcp", (), (), 5)),
        strict=True,
    ):
        folder.mkdir()
        make_case(case, load_object("cube"), SETTINGS, folder)
    pushed, free = (read_dataset(folder / "tosses.h5").tosses for folder in folders)
    n = [min(len(a), len(b)) for a, b in zip(pushed, free, strict=True)]
    apart = [np.linalg.norm(a.q[:k, :3] - b.q[:k, :3], axis=1).max() for a, b, k in zip(pushed, free, n, strict=True)]
    assert np.median(apart) > 10 * SETTINGS.position_noise
    start = [np.linalg.norm(a.q[0, :3] - b.q[0, :3]) for a, b in zip(pushed, free, strict=True)]
    assert max(start) < 10 * SETTINGS.position_noise  # the same releases
