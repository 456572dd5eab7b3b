"""A user's simulator as a world: itself without effects, changed by what effects change, and not asked twice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.models.made import DT, thrown
from tossid.diagnosis.likelihood import users_world
from tossid.diagnosis.likelihood.nearest_contact import Frames, frames_of, nearest_contact
from tossid.diagnosis.likelihood.simulator_process import BatchFunction
from tossid.diagnosis.likelihood.step_changes import Contact, State, StepChanges, motions
from tossid.diagnosis.likelihood.users_world import Motions, UsersWorld
from tossid.objects import ObjectModel
from tossid.physics import System
from tossid.physics import simulate as tossed
from tossid.physics.effects import World, effect_named
from tossid.physics.effects.in_mujoco import toss_in_mujoco

HOW = {"substeps": 4, "impact_parts": 8}


def simulator(system: System) -> BatchFunction:
    """What is asked of a user's simulator, and is `test_simulator_process.py`'s to bring from another process."""

    def simulate(q0: np.ndarray, v0: np.ndarray, n_steps: int, dt: float) -> tuple[np.ndarray, np.ndarray]:
        run = tossed(system, q0, v0, n_steps=n_steps, dt=dt, **HOW)
        return run.q, run.v

    return simulate


@pytest.fixture
def world(cube: ObjectModel) -> UsersWorld:
    """A simulator with another gravity than is stated."""
    return UsersWorld.of(World(cube), simulator(World(cube, gravity=3.0).system()))  # type: ignore[arg-type]


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
    users = UsersWorld.of(World(cube), simulator(theirs.system()))  # type: ignore[arg-type]
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
    level = simulator(World(cube).system())

    def hill(q0: np.ndarray, v0: np.ndarray, n_steps: int, dt: float) -> tuple[np.ndarray, np.ndarray]:
        q, v = level(q0, v0 + 0.01 * np.outer(q0[:, 0], np.eye(6)[0]), n_steps, dt)
        v[:, 0] = v0
        return q, v

    users = UsersWorld.of(World(cube), hill)  # type: ignore[arg-type]
    assert not users.prepared(State(q, v), steps, DT, most_lost=1e9, **HOW).same_everywhere


# ---------------------------------------------------------------- changes of one frame


HALF = 0.0524

SPEED = 0.8


def sliding(height: float) -> State:
    """A cube that slides along x, so high over the ground."""
    return State(np.array([[0.0, 0, HALF + height, 1, 0, 0, 0]]), np.array([[SPEED, 0, 0, 0, 0, 0]]))


@pytest.mark.parametrize(
    ("height", "share", "change"),
    [
        *((0.0, share, share) for share in (0.5, 1.0, 1.5)),  # of the weight, that theirs carries
        (1e-3, 1.0, 1.0),  # theirs touches at some height
        (0.02, 1.0, 0.0),  # what else holds it in the air is no contact
    ],
)
def test_friction_changes_with_the_load_that_theirs_carries(
    cube: ObjectModel, height: float, share: float, change: float
) -> None:
    """By friction of 0.28 in place of 0.18."""
    at = sliding(height)
    theirs = State(at.q, at.v + np.array([0, 0, (share - 1) * 9.81 * DT, 0, 0, 0]))
    world = effect_named("friction").at(World(cube), np.array([0.28]))
    found = StepChanges(world, World(cube), DT, HOW, Contact())(at, theirs)[0, 6]
    assert found == pytest.approx(-0.1 * 9.81 * DT * change, rel=0.05)


def test_gravity_changes_flight_whole_and_rest_not(cube: ObjectModel) -> None:
    heavier = StepChanges(effect_named("gravity").at(World(cube), np.array([10.81])), World(cube), DT, HOW)
    above, below = sliding(0.1), State(sliding(0.0).q, np.zeros((1, 6)))
    fallen = State(above.q, above.v - np.array([0, 0, 9.81 * DT, 0, 0, 0]))
    assert heavier(above, fallen)[0, 8] == pytest.approx(-DT)
    assert heavier(below, below)[0, 8] == pytest.approx(0.0, abs=1e-4)


# ---------------------------------------------------------------- the contact nearest to a simulator


NEAR = {**HOW, "tolerance": 1e-5}
SOFT = Contact(compliance=1e-4, relaxation=0.02, added_mass=2.0, step_count=4)


def frames(contact: Contact, cube: ObjectModel, *, forgets: float = 0.0) -> Frames:
    """Of a simulator with a given contact, which loses a share of velocity whenever it is stopped."""
    system = contact.of(World(cube)).system()

    def motion(q: np.ndarray, v: np.ndarray, steps: NDArray[np.int64], dt: float) -> State:
        return motions(system, State(q, v), steps, dt, contact.steps(NEAR))[0]

    def onward(at: State, dt: float) -> State:
        run, _ = motions(system, State(at.q, (1 - forgets) * at.v), 1, dt, contact.steps(NEAR))
        return run.rows((slice(None), 1))

    first = State(*thrown(np.random.default_rng(2), 8))
    return frames_of(motion, onward, first, np.full(8, 50), DT, World(cube))


def test_contact_that_yields_is_found(cube: ObjectModel) -> None:
    found = nearest_contact(frames(SOFT, cube), World(cube), DT, **NEAR)
    assert found.compliance > 0
    # how hard a corner holds is what it is known by: a step of 1 / 592 s
    assert found.relaxation / found.compliance == pytest.approx(SOFT.relaxation / SOFT.compliance, rel=0.3)
    assert found.step_count == SOFT.step_count


@pytest.mark.parametrize("substeps", [3, 4])
def test_mujoco_s_default_contact_is_known_by_its_steps(cube: ObjectModel, substeps: int) -> None:
    """A frame's velocity is that of MuJoCo to 0.5 mm/s in the median, where rigid contact is 5 mm/s off at least."""
    world = World(cube)

    def motion(q: np.ndarray, v: np.ndarray, steps: NDArray[np.int64], dt: float) -> State:
        return State(*toss_in_mujoco(world, q, v, int(steps.max()), dt, substeps=substeps, soft=True))

    def onward(at: State, dt: float) -> State:
        return motion(at.q, at.v, np.ones(1, dtype=np.int64), dt).rows((slice(None), 1))

    first = State(*thrown(np.random.default_rng(2), 8))
    seen = frames_of(motion, onward, first, np.full(8, 50), DT, world)
    found = nearest_contact(seen, world, DT, **NEAR)
    assert found.step_count == substeps
    assert found.lifting > 0

    def error(contact: Contact) -> float:
        run, _ = motions(contact.of(world).system(), seen.before, 1, DT, contact.steps(NEAR))
        return float(np.median(np.abs(run.v[:, 1, 2] - seen.after.v[:, 2])))

    assert error(found) < 5e-4
    assert error(Contact()) > 5e-3


@pytest.mark.parametrize("contact", [Contact(), Contact(step_count=5)], ids=["stays rigid", "of so many steps"])
def test_rigid_contact_and_its_steps_are_found(cube: ObjectModel, contact: Contact) -> None:
    assert nearest_contact(frames(contact, cube), World(cube), DT, **NEAR) == contact
