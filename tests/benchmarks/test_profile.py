"""The profile's table has tossid's own functions, the longest first."""

from __future__ import annotations

import cProfile
import pstats

from benchmarks.profile import rows
from tossid.errors import brief, nearest


def test_functions_of_tossid_are_listed_the_longest_first() -> None:
    with cProfile.Profile() as profiler:
        for _ in range(50):
            nearest("frcton", ["friction", "gravity"] * 20)
        brief("x")
    table = rows(pstats.Stats(profiler), 1.0)
    assert [row[0] for row in table][:2] == ["errors:nearest", "errors:brief"]
    assert [row[4] for row in table][:2] == ["50", "1"]
