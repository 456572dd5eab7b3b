"""A problem brings tosses into the order of their recording, and its validator knows that order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.diagnosis.tossed import seen
from tests.motion.test_resting import shifted
from tossid.diagnosis.problem import Problem, session_starts
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.types import RecordingOrder, Session


def test_tosses_come_in_the_order_of_their_recording(cube: ObjectModel) -> None:
    a, b, c = (
        replace(toss, name=name) for toss, name in zip(seen(World(cube), cube, 3, seed=1, frames=8), "abc", strict=True)
    )
    problem = Problem((c, a), World(cube), unseen=(b,), names=("a", "b", "c")).in_order()
    assert [toss.name for toss in problem.tosses] == ["a", "c"]
    assert [toss.name for toss in Problem((c, a), World(cube)).in_order().tosses] == ["c", "a"]
    assert Problem((c, a), World(cube), unseen=(b,)).in_order().names == ("c", "a", "b")


def test_sessions_but_the_first_have_starts() -> None:
    sessions = tuple(Session(first, "", 5, None, None, levelled=False, changed={}, note="") for first in ("0", "5"))
    assert session_starts(None) == ()
    assert session_starts(_ordered(sessions)) == ("5",)


def _ordered(sessions: tuple[Session, ...]) -> RecordingOrder:
    none = np.zeros((0, 2))
    return RecordingOrder(sessions, "names", (), (), none, none, none, np.zeros(0), np.zeros(0, int), ())


def test_a_step_of_height_is_a_slow_error_only_where_the_order_is_not_looked_at(cube: ObjectModel) -> None:
    tosses = seen(World(cube), cube, 24, seed=11, frames=150)
    raised = [shifted(toss, 3e-3 * (i >= 14), np.zeros(3)) for i, toss in enumerate(tosses)]
    problem = Problem(raised, World(cube))
    assert problem.validator().windows.slow.any()
    assert not problem.validator(over_order=True).windows.slow.any()
