"""A change of MuJoCo's default contact is named by a diagnosis of the engine without it."""

from __future__ import annotations

import pytest

from experiments.users_simulator import ENGINES, run, table
from tossid.physics.effects.registry import all_effects


@pytest.mark.slow
def test_a_changed_engine_is_named() -> None:
    keep = ("gravity", "com_offset", "inertia")
    others = tuple(each.name for each in all_effects() if not (each.needs_joints or each.name in keep))
    line = run(ENGINES["mujoco"], "gravity-", tosses=8, seed=1, repeats=0, without=others)
    assert line["right"]
    assert line["extra"] == 0
    value, low, high = line["values"]["gravity.g_ms2"]
    assert low < 9.2 < high
    assert value == pytest.approx(9.2, abs=0.02)
    assert line["simulator_cpu_s"] > 0.1
    rows = table([line]).splitlines()
    assert rows[2].startswith("| gravity g_ms2 9.2 | gravity: g_ms2 9.")
    assert rows[-1].startswith("1 of 1 have the right name first, 0 have further names")
