"""Rollouts begin where flight says in the world that is rolled out."""

from __future__ import annotations

import numpy as np

from tests.diagnosis.tossed import seen
from tests.models.conftest import cube
from tests.models.made import thrown
from tossid.diagnosis.gap import first_states
from tossid.diagnosis.windows import make_windows
from tossid.objects import ObjectModel
from tossid.physics.effects import Forces, World

__all__ = ["cube"]


def test_first_states_are_those_of_the_world_with_its_forces(cube: ObjectModel) -> None:
    world = World(cube, forces=Forces(linear=0.3, turning=2.0))
    tosses = seen(world, cube, 20, seed=0)
    _, truth = thrown(np.random.default_rng(0), 20)
    windows = make_windows(tosses, cube)
    flying = windows.toss[windows.free]
    assert len(flying) >= 8

    def missed(asked: World) -> float:
        v = first_states(tosses, asked)[1]
        return float(np.sqrt(((v - truth)[flying, :3] ** 2).mean()))

    assert missed(world) < 0.01
    assert missed(World(cube)) > 5 * missed(world)


def test_windows_of_some_tosses_are_theirs(cube: ObjectModel) -> None:
    tosses = seen(World(cube), cube, 6, seed=1)
    windows, chosen = make_windows(tosses, cube), np.array([4, 1])
    some = windows.of_tosses(chosen)
    assert set(some.toss.tolist()) == {0, 1}
    for number, i in enumerate(chosen):
        np.testing.assert_array_equal(some.y[some.toss == number], windows.y[windows.toss == i])
