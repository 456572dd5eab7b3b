"""Rollouts begin where flight determines it in the world that is rolled out."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.tossed import POSITION, ROTATION, seen
from tests.models.made import DT, thrown
from tossid.diagnosis.likelihood.states import difference
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.diagnosis.localisation.rollouts import (
    distances,
    first_states,
    measured_again,
    rolled_out,
    toss_errors,
    whole_motions,
)
from tossid.objects import ObjectModel
from tossid.physics.effects import Forces, World


def test_first_states_are_those_of_the_world_with_its_forces(cube: ObjectModel) -> None:
    world = World(cube, forces=Forces(linear=0.3, turning=2.0))
    tosses = seen(world, cube, 20, seed=0)
    _, truth = thrown(np.random.default_rng(0), 20)
    windows = make_windows(tosses, cube)
    flying = windows.toss[windows.free]
    assert len(flying) >= 8

    def missed(asked: World) -> float:
        v = first_states(tosses, asked, windows)[1]
        return float(np.sqrt(((v - truth)[flying, :3] ** 2).mean()))

    assert missed(world) < 0.01
    assert missed(World(cube)) > 5 * missed(world)


def test_first_states_with_a_joint_are_those_of_the_flight(elbow: ObjectModel) -> None:
    world = World(elbow)
    tosses = seen(world, elbow, 6, seed=3, frames=30, height=1.0)
    q, v = first_states(tosses, world, make_windows(tosses, elbow))
    run = world.roll_out(q, v, n_steps=30, dt=DT, substeps=4)
    last = np.stack([toss.q[-1] for toss in tosses])
    off = difference(last, run[:, -1])
    assert np.abs(off[:, :3]).max() < 6 * POSITION
    assert np.abs(off[:, 3:]).max() < 8 * ROTATION


def test_rollouts_of_the_right_world_are_nearer_than_of_a_wrong_one(cube: ObjectModel) -> None:
    tosses = seen(World(cube), cube, 6, seed=1)
    windows = make_windows(tosses, cube)
    right, wrong = (
        toss_errors(tosses, world, windows, n_threads=1) for world in (World(cube), World(cube, gravity=7.0))
    )
    assert right.shape == (6, 2)
    assert right[:, 0].mean() < 0.5 * wrong[:, 0].mean()
    # a world of another size is no smaller error
    larger = World(cube.with_changes(corner_pos=2 * cube.corner_pos))
    assert toss_errors(tosses, larger, windows, n_threads=1)[:, 0].mean() > right[:, 0].mean()


def test_tosses_that_a_world_makes_are_near_its_own_predictions(cube: ObjectModel) -> None:
    tosses = seen(World(cube), cube, 4, seed=1)
    windows = make_windows(tosses, cube)
    made = measured_again(tosses, rolled_out(tosses, World(cube), windows), draws=2, seed=3)
    assert [toss.name for toss in made] == [toss.name for toss in tosses for _ in range(2)]
    first = first_states(tosses, World(cube), windows)
    runs = whole_motions(tosses, World(cube), first, windows, 1)
    off = distances([runs[k // 2] for k in range(8)], [toss.q for toss in made], cube.width)
    expected = 100 * POSITION * np.sqrt(8 / np.pi) / cube.width  # mean length of three normal variables
    assert off[:, 0].mean() == pytest.approx(expected, rel=0.1)
