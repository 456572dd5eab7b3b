"""The single body's kernels against the tree's, impacts that depend on no grid of steps, rest, and what runs away."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.physics.trees import EVERYTHING
from tossid.objects import ObjectModel
from tossid.physics import LearnedAcceleration, System, make_system, simulate, stepping
from tossid.physics.contact.law import Law
from tossid.physics.effects import Forces, World
from tossid.rotations import quat_normalize

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
    rng, known = np.random.default_rng(1), systems(cube)
    q, v = np.zeros((40, 7)), rng.normal(size=(40, 6)) * [1, 1, 0.3, 6, 6, 6] - [0, 0, 1, 0, 0, 0]
    q[:, 2], q[:, 3:] = rng.uniform(0.09, 0.15, 40), quat_normalize(rng.normal(size=(40, 4)))
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
