"""Rollouts begin where flight determines it in the world that is rolled out."""

from __future__ import annotations

import numpy as np

from tests.diagnosis.tossed import POSITION, ROTATION, seen, seen_with_joint
from tests.models.made import DT, thrown
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.likelihood.states import difference
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.diagnosis.localisation.rollouts import first_states, rollout_errors
from tossid.diagnosis.selection.cross_validation import CrossValidator
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
        v = first_states(tosses, asked)[1]
        return float(np.sqrt(((v - truth)[flying, :3] ** 2).mean()))

    assert missed(world) < 0.01
    assert missed(World(cube)) > 5 * missed(world)


def test_first_states_with_a_joint_are_those_of_the_flight(elbow: ObjectModel) -> None:
    world = World(elbow)
    tosses = seen_with_joint(world, elbow, 6, seed=3, frames=30, height=1.0)
    q, v = first_states(tosses, world)
    run = world.roll_out(q, v, n_steps=30, dt=DT, substeps=4)
    last = np.stack([toss.q[-1] for toss in tosses])
    off = difference(last, run[:, -1])
    assert np.abs(off[:, :3]).max() < 6 * POSITION
    assert np.abs(off[:, 3:]).max() < 8 * ROTATION


def test_rollouts_of_the_right_world_are_nearer_than_of_a_wrong_one(cube: ObjectModel) -> None:
    tosses = seen(World(cube), cube, 6, seed=1)
    validator = CrossValidator.of(tosses, cube, seed=0)
    right, wrong = (
        rollout_errors(tosses, (), validator.evaluate(Hypothesis(world)), validator)
        for world in (World(cube), World(cube, gravity=7.0))
    )
    assert right.effects == ()
    assert right.position_error_pct.value < 0.5 * wrong.position_error_pct.value
    assert right.unseen_position_error_pct is None
