"""A problem brings tosses into the order of their recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.diagnosis.tossed import seen
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.problem import Problem, session_starts
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.types import RecordingOrder, Session


def test_tosses_come_in_the_order_of_their_recording(cube: ObjectModel) -> None:
    a, b, c = (
        replace(toss, name=name) for toss, name in zip(seen(World(cube), cube, 3, seed=1, frames=8), "abc", strict=True)
    )
    problem = Problem((c, a), Hypothesis(World(cube)), unseen=(b,), names=("a", "b", "c")).in_order()
    assert [toss.name for toss in problem.tosses] == ["a", "c"]
    assert [toss.name for toss in Problem((c, a), Hypothesis(World(cube))).in_order().tosses] == ["c", "a"]
    assert Problem((c, a), Hypothesis(World(cube)), unseen=(b,)).in_order().names == ("c", "a", "b")


def test_sessions_but_the_first_have_starts() -> None:
    sessions = tuple(Session(first, "", 5, None, None, levelled=False, changed={}, note="") for first in ("0", "5"))
    assert session_starts(None) == ()
    assert session_starts(_ordered(sessions)) == ("5",)


def _ordered(sessions: tuple[Session, ...]) -> RecordingOrder:
    none = np.zeros((0, 2))
    return RecordingOrder(sessions, "names", (), (), none, none, none, np.zeros(0), np.zeros(0, int), ())
