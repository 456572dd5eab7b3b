"""A change of MuJoCo's default contact is named by a diagnosis of the engine without it."""

from __future__ import annotations

import pytest

from experiments.users_simulator import ENGINES, named, row, summary
from tossid.physics.effects.registry import all_effects


@pytest.mark.slow
def test_a_changed_engine_is_named() -> None:
    keep = ("gravity", "com_offset", "inertia")
    others = tuple(each.name for each in all_effects() if not (each.needs_joints or each.name in keep))
    case = {"case": "gravity-", "tosses": 8, "seed": 1, "repeats": 0}
    line = {**case, **named(case, ENGINES["mujoco"], without=others)}
    assert line["named"] == ["gravity"]
    value, low, high = line["values"]["gravity.g_ms2"]
    assert low < 9.2 < high
    assert value == pytest.approx(9.2, abs=0.02)
    assert line["passes"] > 1
    assert row(line)[1:3] == ["g_ms2 9.2", f"gravity.g_ms2 {value:.4g} ({low:.4g} to {high:.4g})"]
    assert summary([line]).startswith("1 of 1 have the right name first, 0 have further names")
