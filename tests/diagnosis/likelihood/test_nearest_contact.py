"""The contact nearest to a simulator is found again where tossid has it, and memory beside a state is noticed."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.models.made import DT, thrown
from tossid.diagnosis.likelihood.nearest_contact import Frames, frames_of, nearest_contact
from tossid.diagnosis.likelihood.step_changes import Contact, State, motions
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.physics.effects.in_mujoco import toss_in_mujoco

Array = NDArray[np.float64]
HOW = {"substeps": 4, "impact_parts": 8, "tolerance": 1e-5}
SOFT = Contact(compliance=1e-4, relaxation=0.02, added_mass=2.0, step_count=4)


def frames(contact: Contact, cube: ObjectModel, *, forgets: float = 0.0) -> Frames:
    """Of a simulator with a given contact, which loses a share of velocity whenever it is stopped."""
    system = contact.of(World(cube)).system()

    def motion(q: Array, v: Array, steps: NDArray[np.int64], dt: float) -> State:
        return motions(system, State(q, v), steps, dt, contact.steps(HOW))[0]

    def onward(at: State, dt: float) -> State:
        run, _ = motions(system, State(at.q, (1 - forgets) * at.v), 1, dt, contact.steps(HOW))
        return run.rows((slice(None), 1))

    first = State(*thrown(np.random.default_rng(2), 8))
    return frames_of(motion, onward, first, np.full(8, 50), DT, World(cube))


def test_contact_that_yields_is_found(cube: ObjectModel) -> None:
    found = nearest_contact(frames(SOFT, cube), World(cube), DT, **HOW)
    assert found.compliance > 0
    # how hard a corner holds is what it is known by: a step of 1 / 592 s
    assert found.relaxation / found.compliance == pytest.approx(SOFT.relaxation / SOFT.compliance, rel=0.3)
    assert found.step_count == SOFT.step_count


@pytest.mark.parametrize("substeps", [3, 4])
def test_mujoco_s_default_contact_is_known_by_its_steps(cube: ObjectModel, substeps: int) -> None:
    """A frame's velocity is that of MuJoCo to 0.5 mm/s in the median, where rigid contact is 5 mm/s off at least."""
    world = World(cube)

    def motion(q: Array, v: Array, steps: NDArray[np.int64], dt: float) -> State:
        return State(*toss_in_mujoco(world, q, v, int(steps.max()), dt, substeps=substeps, soft=True))

    def onward(at: State, dt: float) -> State:
        return motion(at.q, at.v, np.ones(1, dtype=np.int64), dt).rows((slice(None), 1))

    first = State(*thrown(np.random.default_rng(2), 8))
    seen = frames_of(motion, onward, first, np.full(8, 50), DT, world)
    found = nearest_contact(seen, world, DT, **HOW)
    assert found.step_count == substeps
    assert found.lifting > 0

    def error(contact: Contact) -> float:
        run, _ = motions(contact.of(world).system(), seen.before, 1, DT, contact.steps(HOW))
        return float(np.median(np.abs(run.v[:, 1, 2] - seen.after.v[:, 2])))

    assert error(found) < 5e-4
    assert error(Contact()) > 5e-3


def test_rigid_contact_stays_rigid(cube: ObjectModel) -> None:
    assert nearest_contact(frames(Contact(), cube), World(cube), DT, **HOW) == Contact()


def test_the_steps_of_rigid_contact_are_found(cube: ObjectModel) -> None:
    coarse = Contact(step_count=5)
    assert nearest_contact(frames(coarse, cube), World(cube), DT, **HOW) == coarse


def test_a_simulator_that_does_not_go_on_from_a_state_is_noticed(cube: ObjectModel) -> None:
    assert frames(Contact(), cube).lost < 0.05
    assert frames(Contact(), cube, forgets=0.1).lost > 0.2
