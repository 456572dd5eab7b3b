"""A user's simulator as a world: itself without effects, changed by what effects change, and not asked twice."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from tests.models.made import DT, thrown
from tossid.diagnosis.likelihood import users_world
from tossid.diagnosis.likelihood.simulator_process import BatchFunction, SimulatorProcess
from tossid.diagnosis.likelihood.step_changes import State
from tossid.diagnosis.likelihood.users_world import Motions, UsersWorld
from tossid.objects import ObjectModel
from tossid.physics import simulate as tossed
from tossid.physics.effects import World, effect_named

HOW = {"substeps": 4, "impact_parts": 8}


@pytest.fixture
def world(cube: ObjectModel) -> Iterator[UsersWorld]:
    """A simulator with another gravity than is stated."""
    moon = World(cube, gravity=3.0).system()

    def simulate(q0: np.ndarray, v0: np.ndarray, n_steps: int, dt: float) -> tuple[np.ndarray, np.ndarray]:
        run = tossed(moon, q0, v0, n_steps=n_steps, dt=dt, **HOW)
        return run.q, run.v

    process = SimulatorProcess(simulate, about="moon", seconds=60.0)
    yield UsersWorld.of(World(cube), process)
    process.close()


def counted(process: BatchFunction) -> tuple[BatchFunction, list[tuple[int, int]]]:
    """A simulator that counts how many motions of how many frames it is asked for."""
    asked: list[tuple[int, int]] = []

    def counting(q: np.ndarray, v: np.ndarray, n_steps: int, dt: float) -> tuple[np.ndarray, np.ndarray]:
        asked.append((len(q), n_steps))
        return process(q, v, n_steps, dt)

    return counting, asked


def test_without_effects_it_is_the_simulator(world: UsersWorld, cube: ObjectModel) -> None:
    q, v = thrown(np.random.default_rng(0), 4)
    steps = np.array([3, 20, 40, 60])
    run = world.roll_out(q, v, n_steps=steps, dt=DT, **HOW)
    wanted = World(cube, gravity=3.0).roll_out(q, v, n_steps=60, dt=DT, **HOW)
    assert run.shape == (4, 61, 7)
    for row, n in enumerate(steps):
        np.testing.assert_allclose(run[row, : n + 1], wanted[row, : n + 1], atol=1e-12)


def test_an_effect_changes_it_as_it_changes_the_stated_object(world: UsersWorld, cube: ObjectModel) -> None:
    q, v = thrown(np.random.default_rng(1), 3)
    q[:, 2] += 5.0  # free
    heavier = effect_named("gravity").at(world, np.array([10.81]))
    assert isinstance(heavier, UsersWorld)
    run = heavier.roll_out(q, v, n_steps=30, dt=DT, **HOW)
    # one m/s² more than the stated 9.81 is one more than the simulator's 3
    wanted = World(cube, gravity=4.0).roll_out(q, v, n_steps=30, dt=DT, **HOW)
    np.testing.assert_allclose(run[..., :3], wanted[..., :3], atol=1e-6)
    np.testing.assert_allclose(np.abs((run[..., 3:] * wanted[..., 3:]).sum(-1)), 1.0, atol=1e-9)


def test_a_motion_is_asked_for_once(world: UsersWorld) -> None:
    counting, asked = counted(world.motions.process)
    world.motions.process = counting  # type: ignore[assignment]
    q, v = thrown(np.random.default_rng(2), 4)
    first = world.roll_out(q, v, n_steps=10, dt=DT, **HOW)
    again = world.roll_out(q, v, n_steps=np.array([10, 4, 10, 7]), dt=DT, **HOW)
    np.testing.assert_array_equal(again[1, :5], first[1, :5])
    assert [rows for rows, _ in asked] == [4]
    world.roll_out(q, v, n_steps=12, dt=DT, **HOW)
    assert [rows for rows, _ in asked] == [4, 4]


def test_motions_are_as_long_as_they_are_needed_and_the_latest_are_kept(
    world: UsersWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    counting, asked = counted(world.motions.process)
    motions = Motions(counting)  # type: ignore[arg-type]
    q, v = thrown(np.random.default_rng(8), 4)
    run = motions(q, v, np.array([9, 40, 10, 3]), DT)
    assert sorted(asked) == [(1, 4), (1, 40), (2, 10)]
    wanted = motions(q[::-1], v[::-1], np.array([3, 10, 40, 9]), DT)
    np.testing.assert_array_equal(run.q, wanted.q[::-1])
    frame = motions.next(State(q, v), DT)
    np.testing.assert_array_equal(frame.v, run.v[:, 1])
    np.testing.assert_array_equal(motions.next(State(q[::-1], v[::-1]), DT).v, frame.v[::-1])
    assert len(asked) == 3

    monkeypatch.setattr(users_world, "_MOST_AT_ONCE", 40)
    motions(q, v + 0.1, np.full(4, 20), DT)
    assert asked[3:] == [(2, 20), (2, 20)]

    monkeypatch.setattr(users_world, "_MOST_KEPT", 3)
    motions(State(q, v).shifted(np.array([0.1, 0.0, 0.0])).q, v, np.full(4, 1), DT)
    np.testing.assert_array_equal(motions(q, v, np.array([9, 40, 10, 3]), DT).q, run.q)
    np.testing.assert_array_equal(motions.next(State(q, v), 2 * DT).q, motions(q, v, np.full(4, 1), 2 * DT).q[:, 1])


def test_a_change_is_composed_frame_by_frame_in_contact(cube: ObjectModel) -> None:
    """Changes of friction and of inertia, on top of a rigid simulator with another gravity, hold through impacts."""
    theirs = World(cube, gravity=9.6)

    def simulate(q0: np.ndarray, v0: np.ndarray, n_steps: int, dt: float) -> tuple[np.ndarray, np.ndarray]:
        run = tossed(theirs.system(), q0, v0, n_steps=n_steps, dt=dt, **HOW)
        return run.q, run.v

    users = UsersWorld.of(World(cube), SimulatorProcess(simulate, about="rigid", seconds=60.0))
    q, v = thrown(np.random.default_rng(3), 12)
    for name, value in (("friction", 0.35), ("inertia", 1.4)):
        run, whole, before, there = (
            each.roll_out(q, v, n_steps=70, dt=DT, **HOW)
            for each in (
                effect_named(name).at(users, np.array([value])),
                effect_named(name).at(replace(users, by_frame=False), np.array([value])),
                users,
                effect_named(name).at(theirs, np.array([value])),
            )
        )
        off, of_whole, gap = (
            np.linalg.norm(each[..., :3] - there[..., :3], axis=-1).max(axis=1) for each in (run, whole, before)
        )
        assert np.median(gap) > 5e-3
        assert np.median(off / gap) < 0.1
        assert np.median(off) < 0.5 * np.median(of_whole)


def test_ground_elsewhere_is_a_change_of_frame(world: UsersWorld, cube: ObjectModel) -> None:
    q, v = thrown(np.random.default_rng(4), 4)
    q[:, 2] += 0.03
    raised = effect_named("ground_height").at(world, np.array([0.02])).roll_out(q, v, n_steps=60, dt=DT, **HOW)
    wanted = World(cube, gravity=3.0, ground_height=0.02).roll_out(q, v, n_steps=60, dt=DT, **HOW)
    np.testing.assert_allclose(raised, wanted, atol=1e-9)


def test_derivatives_by_first_states_ask_for_nothing(world: UsersWorld, cube: ObjectModel) -> None:
    changed = effect_named("friction").at(world, np.array([0.5]))
    q, v = thrown(np.random.default_rng(5), 3)
    before = world.motions.process.frames if world.motions else 0
    plain = changed.by_first_states.roll_out(q, v, n_steps=40, dt=DT, **HOW)
    np.testing.assert_array_equal(plain, World(cube).roll_out(q, v, n_steps=40, dt=DT, **HOW))
    assert world.motions.process.frames == before


def test_motions_near_others_are_not_asked_for_in_the_air(world: UsersWorld) -> None:
    process = world.motions.process
    counting, asked = counted(process)
    q, v = thrown(np.random.default_rng(6), 4)
    q[:2, 2] += 5.0  # these stay in the air
    other, faster = q + np.array([0.0, 0.0, 1e-3, 0.0, 0.0, 0.0, 0.0]), v + 0.01
    steps = np.array([30, 20, 60, 60])
    wanted = world.roll_out(other, faster, n_steps=steps, dt=DT, **HOW)
    world.roll_out(q, v, n_steps=steps, dt=DT, **HOW)
    afresh = replace(world, motions=Motions(process))
    afresh.roll_out(q, v, n_steps=steps, dt=DT, **HOW)
    afresh.motions.process = counting  # type: ignore[assignment]
    run = afresh.roll_out(other, faster, n_steps=steps, dt=DT, near=(q, v), **HOW)
    assert sum(rows for rows, _ in asked) == 2  # those that land,
    assert max(frames for _, frames in asked) < 60  # from shortly before
    for row, n in enumerate(steps):
        np.testing.assert_allclose(run[row, : n + 1], wanted[row, : n + 1], atol=1e-6)


def test_whether_a_simulator_is_the_same_everywhere_is_tried(world: UsersWorld, cube: ObjectModel) -> None:
    q, v = thrown(np.random.default_rng(7), 4)
    steps = np.full(4, 60)
    assert world.prepared(State(q, v), steps, DT, most_lost=1.0, **HOW).same_everywhere
    hill = World(cube).system()

    def simulate(q0: np.ndarray, v0: np.ndarray, n_steps: int, dt: float) -> tuple[np.ndarray, np.ndarray]:
        drawn = v0 + 0.01 * np.concatenate([q0[:, :1], np.zeros((len(q0), 5))], axis=1)
        run = tossed(hill, q0, drawn, n_steps=n_steps, dt=dt, **HOW)
        run.v[:, 0] = v0
        return run.q, run.v

    users = UsersWorld.of(World(cube), SimulatorProcess(simulate, about="hill", seconds=60.0))
    assert not users.prepared(State(q, v), steps, DT, most_lost=1e9, **HOW).same_everywhere
