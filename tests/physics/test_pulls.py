"""What acts on a tree beside gravity and contact: against the single body's kernel, against MuJoCo, and by hand."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.trees import EVERYTHING, flying, jointed, random_tree
from tossid.objects import ObjectModel
from tossid.physics import make_system, simulate, tree_batch
from tossid.physics.batch import mass_matrices
from tossid.physics.effects import Forces, World
from tossid.physics.effects.in_mujoco import toss_in_mujoco

DT = 1 / 148


def test_drag_by_mass_slows_the_common_centre_of_mass_as_one(elbow: ObjectModel) -> None:
    world = World(elbow, gravity=0.0, forces=Forces(linear=0.5))
    q, v = flying(elbow)
    run = simulate(world.system(), q, v, n_steps=40, dt=DT, substeps=4)
    system = make_system(elbow)

    def momentum(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        M = mass_matrices(tree_batch(system, q[None], v[None]), system)[0]
        return np.asarray(M @ v)[:3]

    decay = np.exp(-0.5 / elbow.mass.sum() * 40 * DT)
    for k in range(len(q)):
        before, after = momentum(q[k], v[k]), momentum(run.q[k, -1], run.v[k, -1])
        np.testing.assert_allclose(after, decay * before, atol=2e-3 * np.linalg.norm(before))


@pytest.mark.parametrize(
    "law",
    [
        {"damping": 1e-3},
        {"stiffness": 0.05, "rest": 0.4},
        {"armature": 2e-4},
        {"friction": 4e-3},
        {"damping": 5e-4, "stiffness": 0.02, "rest": -0.3, "armature": 1e-4, "friction": 1e-3},
    ],
    ids=["damping", "stiffness", "armature", "friction", "all"],
)
def test_joints_in_flight_are_mujoco_s(elbow: ObjectModel, law: dict[str, float]) -> None:
    world = World(jointed(elbow, **law))
    q, v = flying(elbow)
    v[:, 6] *= 2
    plain = simulate(make_system(elbow), q, v, n_steps=40, dt=DT, substeps=32)
    ours = simulate(world.system(), q, v, n_steps=40, dt=DT, substeps=32)
    theirs, _ = toss_in_mujoco(world, q, v, 40, DT, substeps=68)
    assert np.abs(ours.q[..., 7] - plain.q[..., 7]).max() > 0.05  # it does something
    assert np.abs(ours.q[..., 7] - theirs[..., 7]).max() < 0.01
    assert np.abs(ours.q[..., :3] - theirs[..., :3]).max() < 2e-3


def test_forces_on_a_tree_are_those_that_mujoco_is_given(elbow: ObjectModel) -> None:
    world = World(elbow, forces=EVERYTHING)
    q, v = flying(elbow)
    q[:, 2] -= 18.0
    ours = simulate(world.system(), q, v, n_steps=30, dt=DT, substeps=16)
    theirs, _ = toss_in_mujoco(world, q, v, 30, DT, substeps=68)
    assert np.abs(ours.q[:, -1, :3] - theirs[:, -1, :3]).max() < 2e-3
    assert np.abs(ours.q[:, -1, 7] - theirs[:, -1, 7]).max() < 0.02


def test_a_joint_is_stable_however_much_it_resists(elbow: ObjectModel) -> None:
    for law in ({"damping": 100.0}, {"friction": 50.0}, {"damping": 1.0, "stiffness": 5.0}):
        run = simulate(make_system(jointed(elbow, **law)), *flying(elbow), n_steps=60, dt=DT)
        assert run.finite.all()
        assert np.abs(run.q[..., 7]).max() < 10.0


def test_joints_that_rub_enough_are_stiff(elbow: ObjectModel) -> None:
    """One exactly, and several together nearly."""
    tree = random_tree(np.random.default_rng(2), n_bodies=4)
    for model, friction, share in ((elbow, 1.0, 1e-12), (tree, 200.0, 0.05)):
        q, v = flying(model)
        v[:, 6:] = 0.0
        held, loose = (
            simulate(make_system(each), q, v, n_steps=5, dt=DT) for each in (jointed(model, friction=friction), model)
        )
        assert np.abs(held.v[..., 6:]).max() < share * np.abs(loose.v[..., 6:]).max()
