"""The single body's kernels against the tree's, impacts that depend on no grid of steps, rest, and what runs away."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.physics.trees import EVERYTHING
from tossid.objects import ObjectModel
from tossid.physics import LearnedAcceleration, Simulation, System, make_system, simulate, stepping
from tossid.physics.contact.law import Law
from tossid.physics.effects import Forces, World

DT = 1 / 148


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


def falling(rng: np.random.Generator, count: int, *, lowest: float) -> tuple[np.ndarray, np.ndarray]:
    """States (count, 7), (count, 6) a little above the ground, on their way down."""
    q = np.zeros((count, 7))
    q[:, 2] = rng.uniform(lowest, 0.15, count)
    q[:, 3:] = rng.normal(size=(count, 4))
    q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1, keepdims=True)
    return q, rng.normal(size=(count, 6)) * [1, 1, 0.3, 6, 6, 6] - [0, 0, 1, 0, 0, 0]


def test_a_toss_that_runs_away_is_reported(cube: ObjectModel) -> None:
    q, v = np.array([[0, 0, 5.0, 1, 0, 0, 0]]), np.array([[0, 0, 0, 1e200, 2e200, 0]])
    run = simulate(make_system(cube), q, v, n_steps=5, dt=DT)
    assert not run.finite[0]
    assert np.isfinite(run.q).all()


@pytest.mark.parametrize("name", ["cube", "elbow"])
def test_an_inertia_that_is_no_body_s_is_reported(name: str, request: pytest.FixtureRequest) -> None:
    model: ObjectModel = request.getfixturevalue(name)
    q = np.zeros((1, model.nq))
    q[0, 2:4] = 0.2, 1.0
    run = simulate(make_system(model)._replace(inertia=-model.inertia), q, np.zeros((1, model.nv)), n_steps=5, dt=DT)
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
BODIES = ("nominal", "odd", "soft", "cohesive", "soft and cohesive", "slow")


def in_both(system: System, monkeypatch: pytest.MonkeyPatch, **how: Any) -> tuple[Simulation, Simulation]:
    """Runs of falling cubes by the kernels of a single body, and by those of a tree."""
    q, v = falling(np.random.default_rng(1), 40, lowest=0.09)
    body = simulate(system, q, v, dt=DT, tolerance=1e-11, **how)
    monkeypatch.setattr(stepping, "make_body", lambda system: None)
    return body, simulate(system._replace(), q, v, dt=DT, tolerance=1e-11, **how)


@pytest.mark.parametrize("name", BODIES)
def test_it_agrees_with_the_tree(cube: ObjectModel, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    system = systems(cube)[name]
    body, tree = in_both(system, monkeypatch, n_steps=25, substeps=3)
    assert (body.lam_n > 0).any(axis=(1, 2)).mean() > 0.8
    # three corners or more carry redundant impulses: which of them is up to the solver's last digits
    redundant = np.cumsum((body.lam_n > 0).sum(axis=2) > 2, axis=1) > 0
    assert redundant.mean() < 0.7
    # and where friction has a memory of them, so is the motion
    settled = system.cohesion == 0.0 or system.compliance > 0.0
    for part, near in (("q", 1e-9), ("v", 1e-7)):
        apart = np.abs(getattr(body, part) - getattr(tree, part))[:, 1:]
        assert apart[~redundant].max() < near, part
        assert apart.max() < 1e3 * near or not settled, part
    assert np.abs(body.lam_n - tree.lam_n)[~redundant].max() < 1e-9


@pytest.mark.parametrize("parts", [1, 8])
@pytest.mark.parametrize("what", ["forces", "bouncing", *LAWS])
def test_a_tree_of_one_body_is_that_body(
    cube: ObjectModel, what: str, parts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    odd = cube.with_changes(com=np.array([[1e-3, -2e-3, 6e-3]]), inertia=cube.inertia * np.diag([1.0, 1.2, 0.9]))
    changes = {"bouncing": {"restitution": 0.4}, "held at once": {"compliance": 3e-5, "relaxation": 2e-3}}
    forces = EVERYTHING._replace(spin=0.0, magnus=0.0) if what == "forces" else Forces()
    world = World(odd.with_changes(**changes.get(what, {})), forces=forces, law=LAWS.get(what, Law()))
    body, linked = in_both(world.system(), monkeypatch, n_steps=12, substeps=2, impact_parts=parts)
    assert (body.lam_n > 0).any(axis=(1, 2)).mean() > 0.6
    apart = np.abs(body.q - linked.q).max(axis=(1, 2))
    # rounding may decide whether a step has an impact
    assert np.median(apart) < (1e-9 if parts == 1 else 3e-4)
    assert (apart < (1e-6 if parts == 1 else 1e-3)).mean() > 0.9
