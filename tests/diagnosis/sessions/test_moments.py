"""Moments of steps are those of the clearest witness, to a toss, and those of sessions that are known nearby."""

from __future__ import annotations

from tests.diagnosis.sessions.test_changes import SETTINGS, step, witness
from tossid.diagnosis.sessions.changes import changes_over_order
from tossid.diagnosis.sessions.moments import at_sessions, clearest_steps, moments_of_steps


def test_the_witness_that_changes_most_clearly_says_when() -> None:
    seen = {"tilt": witness(step(17), seed=4, sigma=0.15), "blurred": witness(step(20), seed=5, sigma=0.8)}
    changes = changes_over_order(seen, SETTINGS)
    assert {name for change in changes for name in change.p} == {"tilt", "blurred"}
    (at,) = clearest_steps(seen, changes, SETTINGS)
    assert abs(at - 17) <= 1


def test_a_step_is_moved_to_where_it_is_likeliest() -> None:
    seen = witness(step(17), seed=8)
    assert abs(moments_of_steps(seen, (21,), SETTINGS)[0] - 17) <= 1
    (at,) = moments_of_steps(seen, (30,), SETTINGS)
    assert at >= 30 - SETTINGS.largest_move


def test_steps_are_at_sessions_that_begin_nearby() -> None:
    assert at_sessions((9, 30), (8, 11, 20), 3) == (8, 30)
    assert at_sessions((9, 10), (11,), 3) == (11,)
    assert at_sessions((2,), (0,), 3) == ()
