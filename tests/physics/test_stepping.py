"""Time stepping: conservation, friction, orders of errors, rest, refusals; a body beside a tree of one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.models.made import DT, thrown
from tests.physics.solvers.contact_problems import landing
from tests.physics.trees import EVERYTHING, random_state, random_tree
from tossid.errors import InputError, ObjectError
from tossid.objects import ObjectModel, corner_positions
from tossid.physics import (
    ExactCone,
    LearnedAcceleration,
    PolyhedralCone,
    System,
    make_system,
    simulate,
    stepping,
    tree_batch,
)
from tossid.physics.batch import mass_matrices
from tossid.physics.contact.law import Law
from tossid.physics.effects import Forces, World
from tossid.physics.solvers import ContactSolver
from tossid.rotations import quat_exp, quat_to_matrix

both_cones = pytest.mark.parametrize("solver", [ExactCone(), PolyhedralCone(4)])


def energy_of_tree(model: ObjectModel, q: np.ndarray, v: np.ndarray) -> float:
    system = make_system(model)
    batch = tree_batch(system, q[None], v[None])
    height = sum(model.mass[b] * (batch.x[0, b] + batch.R[0, b] @ model.com[b])[2] for b in range(model.n_bodies))
    return float(0.5 * v @ mass_matrices(batch, system)[0] @ v + 9.81 * height)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_flight_keeps_energy_to_the_order_of_the_step(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = random_tree(rng, n_bodies=1 + seed, slides=False)
    q, v = random_state(rng, model)
    q[2] = 50.0
    errors = []
    for substeps in (4, 8, 16):
        run = simulate(make_system(model), q[None], v[None], n_steps=20, dt=0.005, substeps=substeps)
        errors.append(abs(energy_of_tree(model, run.q[0, -1], run.v[0, -1]) - energy_of_tree(model, q, v)))
    assert errors[0] > 1e-12
    assert errors[2] < 0.6 * errors[1] < 0.36 * errors[0] * 1.2


def test_tosses_end_at_rest_above_the_ground(cube: ObjectModel) -> None:
    q, v = thrown(np.random.default_rng(0), 40)
    run = simulate(make_system(cube), q, v, n_steps=450, dt=DT, substeps=4)
    assert run.finite.all()
    assert run.unsolved.sum() <= 0.001 * 40 * 1800
    assert np.abs(run.v[:, -1]).max() < 1e-3
    assert corner_positions(cube, run.q)[..., 2].min() > -2e-3
    np.testing.assert_allclose(np.sort(corner_positions(cube, run.q[:, -1])[..., 2], axis=1)[:, :4], 0, atol=1e-4)


def test_threads_and_batches_change_nothing(cube: ObjectModel) -> None:
    q, v = thrown(np.random.default_rng(1), 6)
    one, two, alone = (
        simulate(make_system(cube), q[some], v[some], n_steps=60, dt=DT, n_threads=threads).q
        for some, threads in ((slice(6), 1), (slice(6), 2), (slice(3, 4), 1))
    )
    np.testing.assert_array_equal(one, two)
    np.testing.assert_array_equal(alone[0], one[3])


@both_cones
def test_momentum_changes_by_gravity_and_the_impulses(cube: ObjectModel, solver: ContactSolver) -> None:
    q, v = landing(cube, np.random.default_rng(1), 30)
    run = simulate(make_system(cube), q, v, n_steps=40, dt=DT, solver=solver)
    mass, gained = cube.mass[0], np.diff(run.v[..., 2], axis=1)
    np.testing.assert_allclose(mass * (gained + 9.81 * DT), run.lam_n.sum(axis=2), atol=1e-12)
    # friction is at most mu times the normal impulses
    across = mass * np.linalg.norm(np.diff(run.v[..., :2], axis=1), axis=2)
    assert (across <= cube.friction * run.lam_n.sum(axis=2) * (1 + 1e-6) + 1e-6).all()


def test_without_friction_the_ground_pushes_upwards_only(cube: ObjectModel) -> None:
    """Horizontal momentum stays, and spin changes as the normal impulses' moments say."""
    q, v = landing(cube, np.random.default_rng(2), 30)
    run = simulate(make_system(cube, friction=0.0), q, v, n_steps=1, dt=DT, tolerance=1e-12)
    np.testing.assert_allclose(run.v[:, 1, :2], v[:, :2], atol=1e-12)
    R = quat_to_matrix(q[:, 3:])
    arms = corner_positions(cube, q) - q[:, None, :3]
    moment = np.einsum("bcx,bc->bx", np.cross(arms, [0.0, 0.0, 1.0]), run.lam_n[:, 0])
    gained = np.einsum("bij,jk,bk->bi", R, cube.inertia[0], run.v[:, 1, 3:] - v[:, 3:])
    assert np.abs(moment).max() > 1e-3
    # the gyroscopic change of spin is next to nothing: the cube's moments are equal
    np.testing.assert_allclose(gained, moment, atol=1e-9)


@both_cones
def test_the_ground_is_not_passed(cube: ObjectModel, solver: ContactSolver) -> None:
    """Depth is what a corner turns past the plane that the step saw, and does not grow."""
    q, v = landing(cube, np.random.default_rng(3), 30)
    depth = []
    for substeps in (2, 8):
        run = simulate(make_system(cube), q, v, n_steps=60, dt=DT, substeps=substeps, solver=solver)
        low = corner_positions(cube, run.q)[..., 2].min(axis=2)
        assert low[:, -1].min() > -1e-4
        depth.append(-low.min())
    assert depth[0] < 2e-3
    assert depth[1] < 0.5 * depth[0]


def test_errors_fall_with_the_square_of_the_step(cube: ObjectModel) -> None:
    """Of a body whose centre of mass is off its origin, in flight and as it turns on a corner without friction."""
    com = cube.com.copy()
    com[0] = 0.004, 0.002, -0.003
    spin = np.array([2.0, -1.0, 6.0])
    on_corner, aloft = np.zeros((1, 7)), np.zeros((1, 7))
    on_corner[:, 3:] = aloft[:, 3:] = quat_exp(np.array([0.55, 0.6, 0.1]))
    corners = corner_positions(cube, on_corner)[0]
    on_corner[:, 2], aloft[:, 2] = -corners[:, 2].min(), 2.0
    arm = corners[corners[:, 2].argmin()]
    v = np.array([[*-np.cross(quat_to_matrix(on_corner[0, 3:]) @ spin, arm), *spin]])
    for model, q in ((cube.with_changes(com=com), aloft), (cube, on_corner)):
        runs = [
            simulate(
                make_system(model, friction=0.0), q, v, n_steps=6, dt=DT, substeps=n, impact_parts=8, tolerance=1e-10
            )
            for n in (2, 8, 512)
        ]
        coarse, fine = (np.abs(run.q - runs[-1].q).max() for run in runs[:2])
        assert (runs[-1].lam_n.sum(axis=2) > 0).all() == (q is on_corner)
        assert 1e-9 < fine < coarse / 10


def test_resistance_to_rolling_hardly_hangs_on_the_step(cube: ObjectModel) -> None:
    """It is by the step's own load, also in the step after an impact, which nothing loaded before."""
    system = World(cube, law=Law(rolling=0.03)).system()
    q = np.array([[0, 0, 0.1, *quat_exp(np.array([0.3, 0.2, 0.0]))]])
    v = np.array([[0.2, 0.0, -0.5, 0.0, 3.0, 0.0]])
    coarse, fine = (
        simulate(system, q, v, n_steps=14, dt=DT, substeps=n, impact_parts=8, tolerance=1e-9) for n in (2, 128)
    )
    landed = int((fine.lam_n[0].sum(axis=1) > 0).argmax())
    assert landed < 11
    np.testing.assert_allclose(coarse.q[0, landed + 3, :3], fine.q[0, landed + 3, :3], atol=1e-5)


def test_cohesion_acts_from_the_landing_on_whatever_the_step(cube: ObjectModel) -> None:
    """A cube lands flat at 1 m/s across: by the load of the step before, it slid on for a step without cohesion."""
    sticky = World(cube.with_changes(cohesion=0.3))
    q = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
    q[0, 2] = 5e-4 - corner_positions(cube, q)[..., 2].min()
    v = np.array([[1.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    coarse, fine = (
        sticky.roll_out(q, v, n_steps=12, dt=DT, substeps=substeps, impact_parts=2)[0, -1, 0] for substeps in (2, 64)
    )
    assert abs(coarse - fine) < 5e-4
    plain = World(cube).roll_out(q, v, n_steps=12, dt=DT, substeps=64, impact_parts=2)[0, -1, 0]
    assert plain - fine > 3e-3


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda cube: simulate(make_system(cube), np.zeros((1, 8)), np.zeros((1, 6)), n_steps=1, dt=0.01), "initial"),
        (lambda cube: make_system(cube, gravity=float("nan")), "gravity is"),
        (lambda cube: make_system(cube, friction=-0.1), r"friction is -0\.1"),
        (lambda cube: make_system(cube.with_changes(restitution=0.2, compliance=1e-3)), "restitution 0.2.*compliance"),
        (lambda cube: make_system(cube.with_changes(restitution=0.2, relaxation=1e-3)), "restitution 0.2.*relaxation"),
    ],
)
def test_what_cannot_be_simulated_is_refused(
    cube: ObjectModel, call: Callable[[ObjectModel], object], says: str
) -> None:
    with pytest.raises((InputError, ObjectError), match=says):
        call(cube)


# ---------------------------------------------------------------- a single body and a tree of one


def systems(cube: ObjectModel) -> dict[str, System]:
    rng = np.random.default_rng(0)
    shapes = ((6, 9), (8, 9), (8,), (8, 8), (8,), (6, 8))
    k_res = LearnedAcceleration(*(0.1 * rng.normal(size=shape) for shape in shapes))
    product = 1e-5 * np.array([[0.0, 1, 0], [1, 0, 2], [0, 2, 0]])
    odd = cube.with_changes(com=np.array([[1e-3, -2e-3, 6e-3]]), inertia=1.3 * cube.inertia + product)
    return {
        "nominal": make_system(cube),
        "odd": make_system(
            odd.with_changes(restitution=0.2),
            k_res=k_res,
            friction=np.linspace(0.1, 0.3, 8),
            gravity=[0.1, 0.2, -9.5],
        ),
        "soft": make_system(odd.with_changes(compliance=3e-5, relaxation=2e-3), k_res=k_res),
        "cohesive": make_system(cube.with_changes(cohesion=0.1)),
        "soft and cohesive": make_system(odd.with_changes(compliance=3e-5, relaxation=5e-3, cohesion=0.1)),
        "slow": make_system(odd.with_changes(relaxation=0.02, cohesion=0.05)),
    }


@pytest.mark.parametrize(("name", "inertia", "spin"), [("cube", 1.0, 1e200), ("cube", -1.0, 0.0), ("elbow", -1.0, 0.0)])
def test_a_toss_that_runs_away_or_is_of_no_body_is_reported(
    name: str, inertia: float, spin: float, request: pytest.FixtureRequest
) -> None:
    model: ObjectModel = request.getfixturevalue(name)
    q, v = np.zeros((1, model.nq)), np.zeros((1, model.nv))
    q[0, 2:4], v[0, 3:5] = [0.2, 1.0], [spin, 2 * spin]
    run = simulate(make_system(model)._replace(inertia=inertia * model.inertia), q, v, n_steps=5, dt=DT)
    assert not run.finite[0]
    assert np.isfinite(run.q).all()


def test_a_system_that_was_simulated_cannot_be_changed_in_place(cube: ObjectModel) -> None:
    system = make_system(cube)
    simulate(system, np.array([[0, 0, 0.2, 1, 0, 0, 0]]), np.zeros((1, 6)), n_steps=1, dt=DT)
    with pytest.raises(ValueError, match="read-only"):
        system.inertia[0, 0, 0] = 1.0
    assert system.inertia is not cube.inertia


@pytest.mark.parametrize(("name", "height", "substeps"), [("cube", 0.12, (8, 64)), ("elbow", 0.09, (8,))])
def test_what_an_impact_does_hangs_on_no_grid_of_steps(
    name: str, height: float, substeps: tuple[int, ...], request: pytest.FixtureRequest
) -> None:
    """An impulse in two parts, before and after the end of a step, is not the same impulse: with whole steps, however
    short, the motion sways as often as the impact's time crosses a step."""
    model: ObjectModel = request.getfixturevalue(name)
    q, v = np.zeros((61, model.nq)), np.zeros((61, model.nv))
    q[:, 2], q[:, 7:] = height + np.linspace(0.0, 5e-3, 61), 0.7
    q[:, 3:7] = np.array([0.85, 0.35, 0.25, 0.3]) / np.linalg.norm([0.85, 0.35, 0.25, 0.3])
    v[:, :6], v[:, 6:] = [0.7, 0.2, -1.2, 3.0, -5.0, 2.0], 3.0

    def sways(substeps: int, parts: int) -> float:
        run = simulate(make_system(model), q, v, n_steps=14, dt=DT, substeps=substeps, impact_parts=parts)
        assert (run.lam_n > 0).any(axis=(1, 2)).all()
        x = run.q[:, -1, :3]
        curve = np.polynomial.chebyshev.chebvander(np.linspace(-1, 1, 61), 3)
        return float(np.linalg.norm(x - curve @ (np.linalg.pinv(curve) @ x), axis=1).mean())

    for steps in substeps:
        assert sways(steps, 8) < 0.3 * sways(steps, 1)


@pytest.mark.parametrize("name", ["nominal", "soft", "cohesive"])
def test_what_has_come_to_rest_stays_and_is_carried(cube: ObjectModel, name: str) -> None:
    """The kernel ends a toss at rest; what it fills in is what steps would have come to."""
    system = systems(cube)[name]._replace(k_res=make_system(cube).k_res, com=make_system(cube).com)
    q = np.zeros((1, 7))
    q[0, :4] = 0.0, 0.0, float(-cube.corner_pos[:, 2].min()), 1.0
    out = simulate(system, q, np.array([[0.3, 0.2, -0.2, 0.0, 0.0, 0.5]]), n_steps=200, dt=DT)
    weight = float(system.mass[0]) * 9.81 * DT
    np.testing.assert_allclose(out.lam_n[0, 150:].sum(1), weight, rtol=1e-5)
    np.testing.assert_allclose(out.lam_n[0, -1], out.lam_n[0, 150], rtol=1e-4)
    assert np.abs(out.q[0, 150:] - out.q[0, -1]).max() < 1e-6
    assert np.abs(out.v[0, 150:]).max() < 1e-4


LAWS = {
    "speed and direction in friction": Law(static_rel=1.8, slip_speed=0.3, y_rel=0.6),
    "resistance to spin": Law(torsional=0.02, rolling=0.004),
    "adhesion": Law(adhesion=0.8),
    "rounded": Law(rounding=0.006),
    "relaxed": Law(lifting=1e-3),
    "held at once": Law(added_mass=3.0),
}


@pytest.mark.parametrize("parts", [1, 8])
@pytest.mark.parametrize(
    "what", ["nominal", "odd", "soft", "cohesive", "soft and cohesive", "slow", "forces", "bouncing", *LAWS]
)
def test_a_tree_of_one_body_is_that_body(
    cube: ObjectModel, what: str, parts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Falling cubes by the kernels of a single body, and by those of a tree, as far as rounding lets them agree."""
    known, (q, v) = systems(cube), thrown(np.random.default_rng(1), 40)
    q[:, 2], v[:, 2] = 0.5 * q[:, 2] + 0.02, 0.3 * v[:, 2] - 1.0  # they land soon
    odd = cube.with_changes(com=np.array([[1e-3, -2e-3, 6e-3]]), inertia=cube.inertia * np.diag([1.0, 1.2, 0.9]))
    changes = {"bouncing": {"restitution": 0.4}, "held at once": {"compliance": 3e-5, "relaxation": 2e-3}}
    forces = EVERYTHING._replace(spin=0.0, magnus=0.0) if what == "forces" else Forces()
    world = World(odd.with_changes(**changes.get(what, {})), forces=forces, law=LAWS.get(what, Law()))
    system = known[what] if what in known else world.system()
    how: dict[str, Any] = {"n_steps": 12, "substeps": 2, "dt": DT, "tolerance": 1e-11, "impact_parts": parts}
    body = simulate(system, q, v, **how)
    monkeypatch.setattr(stepping, "make_body", lambda system: None)
    linked = simulate(system._replace(), q, v, **how)
    assert (body.lam_n > 0).any(axis=(1, 2)).mean() > 0.6
    # three corners or more carry redundant impulses: which of them is up to the solver's last digits
    unique = np.cumsum((body.lam_n > 0).sum(axis=2) > 2, axis=1) == 0
    assert unique.mean() > 0.3
    apart = np.abs(body.q - linked.q)[:, 1:].max(axis=2)
    of_tosses = np.where(unique, apart, 0.0).max(axis=1)
    # and rounding may decide whether a step has an impact
    assert np.median(of_tosses) < (1e-9 if parts == 1 else 3e-4)
    assert (of_tosses < (1e-6 if parts == 1 else 1e-3)).mean() > 0.9
