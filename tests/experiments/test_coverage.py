"""The count of intervals that hold the truth."""

from __future__ import annotations

import numpy as np
import pytest

from experiments import coverage
from experiments.coverage import drawn, one_set, row, truth_of
from tossid.objects import ObjectModel


def test_each_parameter_is_held_against_its_own_truth(cube: ObjectModel) -> None:
    true = drawn(cube, np.random.default_rng(0))
    assert truth_of("friction", true) == true.friction != cube.friction
    assert [truth_of(f"com_{axis}_m", true) for axis in "xyz"] == true.com[0].tolist()
    assert [truth_of(f"inertia_{2 * axis}_kgm2", true) for axis in "xyz"] == true.inertia[0].diagonal().tolist()
    assert truth_of("stiffness_npm", true) == np.inf
    assert truth_of("cohesion_n", true) == truth_of("relaxation_s", true) == 0.0


def test_a_row_counts_what_is_determined() -> None:
    one, other = {"model": "cn", "engine": "lcp", "kind": "friction"}, {"model": "cnrpi", "engine": "mujoco"}
    found = [{**one, "holds": holds} for holds in (True, True, False, None)]
    found.append({**other, "kind": "inertia", "holds": True})
    assert row(found, "cn", "lcp") == ["cn", "lcp", "2 of 3", "-", "-", "-", "2 of 3", "67 %", "1 of 4"]
    assert row(found, "all", "all")[-3:] == ["3 of 4", "75 %", "1 of 5"]


def test_a_set_is_tossed_and_learned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(coverage, "MODELS", ("cn",))
    (found,) = one_set({"set": 0, "seed": 3})["found"]
    assert (found["model"], found["engine"], found["kind"]) == ("cn", "lcp", "friction")
