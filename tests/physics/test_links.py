"""Effects on trees: against the single body's kernel, against MuJoCo, and by hand."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.test_body import falling
from tests.physics.trees import random_state, random_tree
from tossid.errors import ObjectError
from tossid.objects import OBJECT_FILES, JointLaw, ObjectModel, load_object
from tossid.physics import Simulation, make_system, simulate, stepping, tree
from tossid.physics.effects import JOINT_EFFECTS, Forces, Law, RecordingErrors, World, effects_for
from tossid.physics.effects.in_mujoco import toss_in_mujoco

DT = 1 / 148


@pytest.fixture(scope="module")
def cube() -> ObjectModel:
    return load_object(OBJECT_FILES / "cube.xml")


@pytest.fixture(scope="module")
def elbow() -> ObjectModel:
    return load_object(OBJECT_FILES / "elbow.xml")


def jointed(model: ObjectModel, **law: float) -> ObjectModel:
    there = np.arange(model.n_bodies) > 0
    return model.with_changes(joint_law=JointLaw(*(law.get(name, 0.0) * there for name in JointLaw._fields)))


def flying(model: ObjectModel, count: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """States high above the ground."""
    rng = np.random.default_rng(3)
    q, v = map(np.array, zip(*(random_state(rng, model) for _ in range(count)), strict=True))
    q[:, 2] += 20.0
    return q, v


EVERYTHING = Forces(0.1, 0.1, 0.002, 2.0, -1.0, 0.03, 0.3, -0.2, 0.5, 4.0, 0.3, 0.2, 1.0, 2.0, 1.5)
CONTACTS = {
    "speed and direction in friction": Law(static_rel=1.8, slip_speed=0.3, y_rel=0.6),
    "resistance to spin": Law(torsional=0.02, rolling=0.004),
    "adhesion": Law(adhesion=0.8),
    "rounded": Law(rounding=0.006),
    "relaxed": Law(lifting=1e-3),
    "held at once": Law(added_mass=3.0),
}


@pytest.mark.parametrize("parts", [1, 8])
@pytest.mark.parametrize("what", ["forces", "bouncing", "soft", *CONTACTS])
def test_a_tree_of_one_body_is_that_body(
    cube: ObjectModel, what: str, parts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    odd = cube.with_changes(com=np.array([[1e-3, -2e-3, 6e-3]]), inertia=cube.inertia * np.diag([1.0, 1.2, 0.9]))
    if what == "bouncing":
        odd = odd.with_changes(restitution=0.4)
    if what in ("soft", "held at once"):
        odd = odd.with_changes(compliance=3e-5, relaxation=2e-3)
    forces = EVERYTHING._replace(spin=0.0, magnus=0.0) if what == "forces" else Forces()
    system = World(odd, forces=forces, law=CONTACTS.get(what, Law())).system()
    q, v = falling(np.random.default_rng(1), 30, lowest=0.1)
    runs: list[Simulation] = []
    for _ in range(2):
        runs.append(simulate(system, q, v, n_steps=12, dt=DT, substeps=2, impact_parts=parts, tolerance=1e-11))
        monkeypatch.setattr(stepping, "make_body", lambda system: None)
    body, linked = runs
    assert (body.lam_n > 0).any(axis=(1, 2)).mean() > 0.6
    apart = np.abs(body.q - linked.q).max(axis=(1, 2))
    # a tree knows its angular acceleration when it looks for an impact, a single body neglects it
    assert np.median(apart) < (1e-9 if parts == 1 or what == "soft" else 3e-4)
    assert (apart < (1e-6 if parts == 1 or what == "soft" else 1e-3)).mean() > 0.9


def test_spin_s_drag_and_magnus_come_near_the_body_s(cube: ObjectModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are taken at the step's start there and at its middle here: apart in proportion to the step."""
    system = World(cube, forces=EVERYTHING).system()
    q, v = flying(cube)
    misses = []
    for substeps in (4, 8):
        with monkeypatch.context() as patch:
            body = simulate(system, q, v, n_steps=30, dt=DT, substeps=substeps)
            patch.setattr(stepping, "make_body", lambda system: None)
            linked = simulate(system, q, v, n_steps=30, dt=DT, substeps=substeps)
        misses.append(np.abs(body.q - linked.q).max())
    assert misses[0] < 2e-3
    assert misses[1] < 0.6 * misses[0]


def test_drag_by_mass_slows_the_common_centre_of_mass_as_one(elbow: ObjectModel) -> None:
    world = World(elbow, gravity=0.0, forces=Forces(linear=0.5))
    q, v = flying(elbow)
    run = simulate(world.system(), q, v, n_steps=40, dt=DT, substeps=4)
    system = make_system(elbow)

    def momentum(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        work = tree.make_work(system)
        tree.kinematics(system, q, work)
        tree.mass_matrix(system, work)
        return (work.M @ v)[:3]

    decay = np.exp(-0.5 / elbow.mass.sum() * 40 * DT)
    for k in range(len(q)):
        before, after = momentum(q[k], v[k]), momentum(run.q[k, -1], run.v[k, -1])
        np.testing.assert_allclose(after, decay * before, atol=2e-3 * np.linalg.norm(before))


def test_a_uniform_force_is_gravity_s_like(elbow: ObjectModel) -> None:
    q, v = flying(elbow)
    weight = float(elbow.mass.sum())
    pulled = World(elbow, forces=Forces(z=2.0 * weight))
    light = World(elbow, gravity=7.81)
    runs = [simulate(w.system(), q, v, n_steps=30, dt=DT, substeps=2).q for w in (pulled, light)]
    np.testing.assert_allclose(*runs, atol=1e-9)


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


def test_a_joint_that_rubs_enough_is_stiff(elbow: ObjectModel) -> None:
    q, v = flying(elbow)
    v[:, 6] = 0.0
    run = simulate(make_system(jointed(elbow, friction=1.0)), q, v, n_steps=40, dt=DT)
    np.testing.assert_allclose(run.v[..., 6], 0.0, atol=1e-12)


def test_several_joints_rub_together(elbow: ObjectModel) -> None:
    rng = np.random.default_rng(2)
    model = random_tree(rng, n_bodies=4)
    q, v = flying(model)
    v[:, 6:] = 0.0
    run = simulate(make_system(jointed(model, friction=200.0)), q, v, n_steps=5, dt=DT)
    still = simulate(make_system(model), q, v, n_steps=5, dt=DT)
    assert np.abs(run.v[..., 6:]).max() < 0.05 * np.abs(still.v[..., 6:]).max()


def test_what_an_impact_of_a_tree_does_hangs_on_no_grid_of_steps(elbow: ObjectModel) -> None:
    """As for a single body (test_body): with whole steps the motion sways as often as the impact crosses a step."""
    heights = np.linspace(0.0, 5e-3, 61)
    q, v = np.zeros((61, 8)), np.zeros((61, 7))
    q[:, 3:7] = np.array([0.85, 0.35, 0.25, 0.3]) / np.linalg.norm([0.85, 0.35, 0.25, 0.3])
    q[:, 2], q[:, 7], v[:] = 0.09 + heights, 0.7, [0.7, 0.2, -1.2, 3.0, -5.0, 2.0, 3.0]

    def sways(parts: int) -> float:
        run = simulate(make_system(elbow), q, v, n_steps=14, dt=DT, substeps=8, impact_parts=parts)
        assert (run.lam_n > 0).any(axis=(1, 2)).all()
        x = run.q[:, -1, :3]
        curve = np.polynomial.chebyshev.chebvander(np.linspace(-1, 1, 61), 3)
        return float(np.linalg.norm(x - curve @ (np.linalg.pinv(curve) @ x), axis=1).mean())

    assert sways(8) < 0.3 * sways(1)


def test_the_library_of_an_object_with_joints(cube: ObjectModel, elbow: ObjectModel) -> None:
    assert {e.name for e in effects_for(elbow)} - {e.name for e in effects_for(cube)} == {
        "joint_damping",
        "joint_friction",
        "joint_stiffness",
        "joint_offset",
    }
    world = World(jointed(elbow, damping=1e-3))
    q, v = flying(elbow)
    nominal = world.roll_out(q, v, n_steps=10, dt=DT, substeps=2)
    for effect in JOINT_EFFECTS:
        same = effect.at(world, effect.nominal(world))
        np.testing.assert_array_equal(same.roll_out(q, v, n_steps=10, dt=DT, substeps=2), nominal)


def test_the_inertia_of_links_may_be_of_another_shape(cube: ObjectModel, elbow: ObjectModel) -> None:
    of_links, of_a_body = ({e.name: e for e in effects_for(model)}["inertia"] for model in (elbow, cube))
    world = World(elbow)
    same = of_links.at(world, of_links.nominal(world))
    np.testing.assert_allclose(same.object.inertia, elbow.inertia, rtol=1e-12)
    larger = of_links.at(world, np.array([1.3, 1.0, 1.0])).object.inertia
    np.testing.assert_allclose(larger, of_a_body.at(world, np.array([1.3])).object.inertia, rtol=1e-12)

    # a solid box of 1, 2, 3 becomes one of 1, 4, 1.5
    box = 0.1 * np.array([1.0, 4.0, 9.0]) / 12
    moments = np.diag(box.sum() - box)
    boxes = World(elbow.with_changes(inertia=np.tile(moments, (2, 1, 1))))
    found = of_links.at(boxes, np.array([1.0, 4.0, 0.25])).object.inertia
    other = 0.1 * np.array([1.0, 16.0, 2.25]) / 12
    np.testing.assert_allclose(found, np.tile(np.diag(other.sum() - other), (2, 1, 1)), atol=1e-15)
    for least in ([5.0, 0.05, 0.05], [0.2, 10.0, 0.05], [1.0, 10.0, 10.0]):
        a, b, c = np.linalg.eigvalsh(of_links.at(world, np.array(least)).object.inertia[1])
        assert 0 < a <= b <= c < a + b


def test_recorded_joints_come_back(elbow: ObjectModel) -> None:
    world = World(elbow, recording=RecordingErrors(length_scale=1.1, clock_rate=0.9, joint_offset=0.3))
    q, v = flying(elbow)
    recorded_q, recorded_v = world.recorded(q, v)
    np.testing.assert_allclose(recorded_q[:, 7], q[:, 7] + 0.3)
    back = world.to_ground(recorded_q, recorded_v)
    np.testing.assert_allclose(back[0], q, atol=1e-12)
    np.testing.assert_allclose(back[1], v, atol=1e-12)


def test_a_joint_that_pushes_itself_is_refused(elbow: ObjectModel) -> None:
    with pytest.raises(ObjectError, match="damping of a joint is -1"):
        jointed(elbow, damping=-1.0)
