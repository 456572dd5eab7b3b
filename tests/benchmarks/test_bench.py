"""What `make bench` compares: random releases, and work that runs in turns."""

from __future__ import annotations

import numpy as np

from benchmarks.bench import FRAMES, REPETITIONS, first_states, in_turns, mujoco_rollout, random_states
from tests.models.made import tosses
from tossid.objects import ObjectModel


def test_work_runs_in_turns() -> None:
    order: list[str] = []
    found = in_turns({"a": lambda: order.append("a"), "b": lambda: order.append("b")})
    assert order == ["a", "b"] * (REPETITIONS + 1)
    assert found.keys() == {"a", "b"}


def test_random_releases_are_above_the_ground(elbow: ObjectModel) -> None:
    start = random_states(elbow, 20)
    assert start.q.shape == (20, 8)
    assert (start.q[:, 2] >= 0.1).all()
    np.testing.assert_allclose(np.linalg.norm(start.q[:, 3:7], axis=1), 1.0)
    assert (start.n_steps == FRAMES).all()


def test_both_simulators_begin_where_the_tosses_do(cube: ObjectModel) -> None:
    made = tosses(cube, 2, seed=0, frames=5)
    start = first_states(made)
    np.testing.assert_array_equal(start.q[1], made[1].q[0])
    assert start.n_steps.tolist() == [5, 5]
    mujoco_rollout(cube, start)()
