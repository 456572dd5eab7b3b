"""The profile charges time to what is innermost, and counts motions for the stage that asked for them."""

from __future__ import annotations

import sys
from types import ModuleType

import numpy as np
import pytest

from benchmarks import profile
from benchmarks.profile import STAGES, WORK, Ledger


def test_time_goes_to_the_innermost_name(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(profile.time, "process_time", lambda: now[0])
    ledger = Ledger(since=0.0)
    now[0] = 1.0
    with ledger.under("outer"):
        now[0] = 3.0
        with ledger.under("inner"):
            now[0] = 8.0
            ledger.simulated(4, 80)
        now[0] = 9.0
    assert ledger.seconds == {"the rest": 1.0, "outer": 3.0, "inner": 5.0}
    assert ledger.rows()[0] == ["inner", "5.00", "55.6 %", "1", "4", "80"]


@pytest.mark.parametrize(("name", "where"), [*STAGES, *WORK])
def test_every_stage_is_a_function_of_the_library(name: str, where: str) -> None:
    module, _, path = where.partition(":")
    owner = __import__(module, fromlist=["_"])
    for part in path.split("."):
        owner = getattr(owner, part)
    assert callable(owner), name


def test_motions_are_counted_wherever_the_function_was_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    made, user = ModuleType("tossid.made"), ModuleType("tossid.user")
    made.simulate = user.simulate = lambda system, q, *, n_steps: "done"  # type: ignore[attr-defined]
    for module in (made, user):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    ledger, stages = Ledger(), Ledger()
    profile.observe((("simulator", "tossid.made:simulate"),), ledger, count=stages)
    for module in (made, user):
        assert module.simulate(None, np.zeros((3, 7)), n_steps=np.array([5, 6, 7])) == "done"
    assert ledger.calls == {"simulator": 2}
    assert stages.motions == {"the rest": 6}
    assert stages.frames == {"the rest": 36}
