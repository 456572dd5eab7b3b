"""Tosses whose heights were set one by one are recognised, and turned about the corner whose height was set."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen, with_effect
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.sessions.correction import corrected_tosses
from tossid.diagnosis.sessions.heights import ending_at_origin, have_own_heights, last_corner, moved
from tossid.motion.sessions.levelling import IDENTITY
from tossid.objects import ObjectModel, corner_positions
from tossid.physics.effects import World
from tossid.types import RecordingOrder, Toss

TILT = np.array([0.03, -0.02])


def lowest(model: ObjectModel, toss: Toss) -> float:
    return float(corner_positions(model, toss.q[-1:])[..., 2].min())


@pytest.fixture(scope="module")
def shifted(cube: ObjectModel) -> tuple[Toss, ...]:
    """Tosses at rest in a tilted world, each shifted so that its last frame's lowest corner is at 0."""
    made = []
    for i, toss in enumerate(seen(with_effect(cube, "world_tilt", list(TILT)), cube, 12, seed=7, frames=150)):
        q = toss.q.copy()
        q[:, 2] -= lowest(cube, toss)
        made.append(replace(toss, q=q, name=str(i)))
    return tuple(made)


def test_heights_that_were_set_one_by_one_are_recognised(cube: ObjectModel, shifted: tuple[Toss, ...]) -> None:
    assert have_own_heights(shifted, cube, None)
    assert not have_own_heights(seen(World(cube), cube, 6, seed=1, frames=20), cube, None)
    # (ingest raised them, and says by how much)
    raised = tuple(replace(toss, q=toss.q + np.eye(7)[2] * 1e-3 * i) for i, toss in enumerate(shifted))
    n, names = len(raised), tuple(toss.name for toss in raised)
    places, none = np.zeros((n, 2)), np.zeros(n, dtype=np.int64)
    turns = np.tile(IDENTITY, (n, 1))
    order = RecordingOrder((), "names", names, (), np.zeros((n, 0)), places, turns, 1e-3 * np.arange(n), none)
    assert not have_own_heights(raised, cube, None)
    assert have_own_heights(raised, cube, order)


def test_a_tilt_turns_them_about_the_corner_whose_height_was_set(cube: ObjectModel, shifted: tuple[Toss, ...]) -> None:
    # as on a table half a metre wide
    far = [moved(toss, np.array([0.3 * np.cos(i), 0.3 * np.sin(i)])) for i, toss in enumerate(shifted)]
    how = {"world": World(cube), "effect": EFFECTS["world_tilt"], "values": np.tile(TILT, (len(far), 1))}
    right = corrected_tosses(far, **how, own_heights=True)
    about_origin = corrected_tosses(far, **how)
    assert max(abs(lowest(cube, toss)) for toss in right) < 5e-4
    assert max(abs(lowest(cube, toss)) for toss in about_origin) > 8e-3
    for toss, before in zip(right, far, strict=True):
        np.testing.assert_allclose(toss.q[-1, :2], before.q[-1, :2], atol=3e-3)


def test_over_the_order_they_all_end_at_one_place(cube: ObjectModel, shifted: tuple[Toss, ...]) -> None:
    at_origin = ending_at_origin(shifted, cube)
    np.testing.assert_allclose([last_corner(toss, cube) for toss in at_origin], 0.0, atol=1e-12)
    np.testing.assert_array_equal([toss.q[:, 2:] for toss in at_origin], [toss.q[:, 2:] for toss in shifted])
    problem = Problem(shifted, World(cube), own_heights=True)
    places = problem.validator(over_order=True).windows.at_q[:, :2]
    elsewhere = problem.validator().windows.at_q[:, :2]
    own = np.array([last_corner(toss, cube) for toss in shifted])[problem.validator().windows.toss]
    np.testing.assert_allclose(places, elsewhere - own, atol=1e-9)
