"""The implicit loss: its value against plain NumPy, its gradient against differences, and what it refuses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.models.made import toss_of, tosses
from tests.physics.trees import random_tree
from tossid.errors import InputError
from tossid.models.implicit import Bodies, Dynamics, LossTerms, LossWeights, free_acceleration, implicit_loss
from tossid.models.transitions import Transitions, make_transitions
from tossid.objects import ObjectModel, corner_positions, object_from_mjcf
from tossid.physics.solvers import ConeProgramme, solve_contacts
from tossid.rotations import skew

WEIGHTS = LossWeights(complementarity=0.7, dissipation=0.3, penetration=1.3, gap_scale=2e-3)
CAPSULE = """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body name="capsule"><freejoint/>
<geom type="capsule" size="0.02 0.04" mass="0.3" friction="0.3 0 0"/></body></worldbody></mujoco>"""


def made_up(model: ObjectModel, rng: np.random.Generator, *, count: int = 60) -> Transitions:
    """Random states that touch the ground, sink into it, or are above it, with velocities that no dynamics connects."""
    q = np.zeros((count, model.nq))
    q[:, 3:] = rng.normal(size=(count, model.nq - 3))
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    lowest = corner_positions(model, q)[..., 2].min(axis=1)
    q[:, 2] += rng.uniform(-0.05, 0.3, count) * model.width - lowest
    v = rng.normal(size=(count, model.nv))
    v[1:] = 0.6 * v[:-1] + 0.4 * v[1:]
    return make_transitions(model, [toss_of("made up", q, v)])


def random_bodies(model: ObjectModel, rng: np.random.Generator) -> Bodies:
    """Bodies far from the object's: centres of mass off the origins, full inertia."""
    points = model.width * rng.normal(size=(model.n_bodies, 20, 3)) + 0.2 * model.width
    mass = model.mass * rng.uniform(0.5, 2.0, model.n_bodies)
    second = np.einsum("b,bpi,bpj->bij", mass / 20, points, points)
    inertia = np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second
    return Bodies(*(torch.from_numpy(part) for part in (mass, mass[:, None] * points.mean(axis=1), inertia)))


def problem(seed: int, model: ObjectModel) -> tuple[Transitions, Dynamics, dict[str, Any]]:
    """Transitions of an object, numbers far from its own, and the further arguments of the loss."""
    rng = np.random.default_rng(seed)
    t = made_up(model, rng)
    d = Dynamics(
        random_bodies(model, rng),
        torch.from_numpy(model.corner_pos + 0.05 * model.width * rng.normal(size=model.corner_pos.shape)),
        torch.tensor(rng.uniform(0.05, 0.8), dtype=torch.float64),
        torch.tensor([0.0, 0.0, -9.81], dtype=torch.float64) + torch.from_numpy(rng.normal(size=3)),
        torch.from_numpy(rng.normal(size=(len(t), model.nv))) if seed % 3 else None,
    )
    options = {"corner_body": torch.as_tensor(model.corner_body), "roundness": model.roundness}
    return t, d, {**options, "metric": random_bodies(model, rng), "weights": WEIGHTS}


def sum_of(terms: LossTerms) -> Tensor:
    return terms.prediction + terms.complementarity + terms.dissipation + terms.penetration


def numbers_of(d: Dynamics) -> list[Tensor]:
    return [*d.bodies, d.corner_pos, d.mu, d.gravity, *([] if d.a_res is None else [d.a_res])]


def with_numbers(numbers: list[Tensor]) -> Dynamics:
    return Dynamics(Bodies(*numbers[:3]), *numbers[3:6], numbers[6] if len(numbers) > 6 else None)


def mass_matrix(X: np.ndarray, bodies: Bodies) -> np.ndarray:
    """M (nv, nv) of the bodies' Jacobians (n_b, 6, nv)."""
    mass, moment, inertia = (part.numpy() for part in bodies)
    blocks = [
        np.block([[inertia[b], skew(moment[b])], [-skew(moment[b]), mass[b] * np.eye(3)]]) for b in range(len(mass))
    ]
    return np.asarray(sum(x.T @ block @ x for x, block in zip(X, blocks, strict=True)))


def free_motion(t: Transitions, n: int, d: Dynamics) -> np.ndarray:
    """M^-1 k + a_res (nv,) of transition n, body by body: M dv/dt = -sum over bodies of X^T (bias wrench)."""
    mass, moment, inertia = (part.numpy() for part in d.bodies)
    total, R = np.zeros(t.dv.shape[1]), t.R[n].numpy()
    for b, (m, h, I) in enumerate(zip(mass, moment, inertia, strict=True)):
        w, alpha = t.omega[n, b].numpy(), t.alpha[n, b].numpy()
        acc = t.xdd[n, b].numpy() - R[b].T @ d.gravity.numpy()
        force = m * acc + np.cross(alpha, h) + np.cross(w, np.cross(w, h))
        torque = I @ alpha + np.cross(w, I @ w) + np.cross(h, acc)
        total -= t.X[n, b].numpy().T @ np.concatenate([torque, force])
    a = np.linalg.solve(mass_matrix(t.X[n].numpy(), d.bodies), total)
    if d.a_res is not None:
        a += np.concatenate([R[0] @ d.a_res[n, :3].numpy(), d.a_res[n, 3:].numpy()])
    return a


def reference(t: Transitions, d: Dynamics, options: dict[str, Any]) -> np.ndarray:
    """The four terms in plain NumPy, transition by transition, in the world's axes."""
    terms, weights, mu, roundness = np.zeros(4), options["weights"], float(d.mu), options["roundness"]
    body, total, near = options["corner_body"].numpy(), float(options["metric"].mass.sum()), set(t.near.tolist())
    for n in range(len(t)):
        X, R, dt = t.X[n].numpy(), t.R[n].numpy(), float(t.dt[n])
        M, W = mass_matrix(X, d.bodies), mass_matrix(X, options["metric"])
        miss = t.dv[n].numpy() - dt * free_motion(t, n, d)
        if n in near:
            hit = lowest = d.corner_pos.numpy()
            up = t.up_next[n].numpy()[body]
            if roundness is not None:
                hit, lowest = hit + roundness.offset(-R[body, 2]), lowest + roundness.offset(-up)
            J = np.stack([R[b] @ (X[b, 3:] - skew(r) @ X[b, :3]) for b, r in zip(body, hit, strict=True)])
            rows = np.concatenate([J[:, 2], J[:, :2].reshape(-1, J.shape[2])])
            phi = t.z_next[n].numpy()[body] + (up * lowest).sum(axis=1)
            gap = (np.sqrt(phi**2 + weights.gap_scale**2) - weights.gap_scale) / dt
            s = J[:, :2] @ t.v_next[n].numpy()
            speed = np.linalg.norm(s, axis=1)
            cost = np.concatenate(
                [weights.complementarity * gap + weights.dissipation * mu * speed, weights.dissipation * s.ravel()]
            )
            response = np.linalg.solve(M, rows.T)
            linear = cost - response.T @ W @ miss
            problem = (response.T @ W @ response)[None], linear[None], np.full(len(phi), mu)
            lam = solve_contacts(*problem, solver=ConeProgramme()).lam[0]
            miss = miss - response @ lam
            count = len(phi)
            terms[1] += weights.complementarity * lam[:count] @ gap / total
            terms[2] += weights.dissipation * (mu * lam[:count] @ speed + lam[count:] @ s.ravel()) / total
            terms[3] += 0.5 * weights.penetration * ((np.minimum(phi, 0.0) / dt) ** 2).sum()
        terms[0] += 0.5 * miss @ W @ miss / total
    return terms / len(t)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("kind", ["cube", "tree of 2", "tree of 4", "capsule"])
def test_its_terms_are_those_of_plain_numpy(cube: ObjectModel, kind: str, seed: int) -> None:
    bodies = int(kind[-1]) if kind.startswith("tree") else 1
    model = random_tree(np.random.default_rng(seed), n_bodies=bodies) if bodies > 1 else cube
    model = object_from_mjcf(CAPSULE, name="capsule") if kind == "capsule" else model
    t, d, options = problem(seed, model)
    assert len(t.near) > 0
    found = implicit_loss(t, d, **options)
    assert found.unsolved == 0
    np.testing.assert_allclose([float(term) for term in found[:4]], reference(t, d, options), rtol=1e-9)
    expected = np.array([free_motion(t, n, d) for n in range(len(t))])
    np.testing.assert_allclose(free_acceleration(t, d).numpy(), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("bodies", [1, 3])
def test_its_gradient_is_that_of_differences(cube: ObjectModel, bodies: int) -> None:
    """In every number: mass, moment, inertia, corners, friction, gravity and learned acceleration."""
    rng = np.random.default_rng(0)
    t, d, options = problem(2, cube if bodies == 1 else random_tree(rng, n_bodies=bodies))
    numbers = [number.requires_grad_() for number in numbers_of(d)]
    gradients = torch.autograd.grad(sum_of(implicit_loss(t, d, **options)), numbers)
    for i, (number, gradient) in enumerate(zip(numbers, gradients, strict=True)):
        direction = torch.from_numpy(np.array(rng.normal(size=number.shape)))
        if i == 2:  # an inertia is symmetric
            direction = direction + direction.mT
        step = 1e-6 * number.detach().abs().max() * direction
        above, below = (
            sum_of(implicit_loss(t, with_numbers([*numbers[:i], number + by * step, *numbers[i + 1 :]]), **options))
            for by in (1, -1)
        )
        slope = float((above - below).detach()) / 2
        assert float((gradient * step).sum()) == pytest.approx(slope, rel=1e-5), i


def test_numbers_that_are_no_body_are_not_repaired(cube: ObjectModel) -> None:
    t, d, options = problem(5, cube)
    broken = implicit_loss(t, d._replace(bodies=d.bodies._replace(inertia=-d.bodies.inertia)), **options)
    assert not torch.isfinite(broken.prediction)
    assert broken.unsolved == len(t.near)
    with pytest.raises(InputError, match="friction"):
        implicit_loss(t, d._replace(mu=torch.tensor(-0.1, dtype=torch.float64)), **options)


def test_friction_may_be_none_and_contact_may_be_none(cube: ObjectModel) -> None:
    t, d, options = problem(6, cube)
    d = d._replace(mu=torch.tensor(0.0, dtype=torch.float64, requires_grad=True))
    loss = sum_of(implicit_loss(t, d, **options))
    assert torch.isfinite(torch.autograd.grad(loss, [d.mu])[0])
    slightly = sum_of(implicit_loss(t, d._replace(mu=d.mu + 1e-7), **options))
    assert float(loss.detach()) == pytest.approx(float(slightly.detach()), rel=1e-4)
    above = replace(t, near=t.near[:0])
    prediction, *touching, _ = implicit_loss(above, d, **options)
    assert float(prediction.detach()) > 0
    assert [float(term.detach()) for term in touching] == [0.0, 0.0, 0.0]


def test_the_true_dynamics_have_no_loss_in_flight_and_next_to_none_in_contact(cube: ObjectModel) -> None:
    """Tosses of the time-stepping simulator satisfy its own equations; a gap within a step costs a little."""
    t = make_transitions(cube, tosses(cube, 3, seed=4))
    bodies = Bodies(*(torch.as_tensor(part) for part in (cube.mass, cube.mass[:, None] * cube.com, cube.inertia)))
    gravity = torch.tensor([0.0, 0.0, -9.81], dtype=torch.float64)
    mu = torch.tensor(cube.friction, dtype=torch.float64)
    truth = Dynamics(bodies, torch.as_tensor(cube.corner_pos), mu, gravity, None)
    options = {"corner_body": torch.as_tensor(cube.corner_body), "metric": bodies, "weights": WEIGHTS}
    assert float(implicit_loss(t.in_flight(), truth, **options).prediction) < 1e-16
    everything = float(sum_of(implicit_loss(t, truth, **options)))
    for wrong in (
        truth._replace(mu=0.5 * truth.mu),
        truth._replace(gravity=0.9 * truth.gravity),
        truth._replace(corner_pos=1.1 * truth.corner_pos),
        truth._replace(corner_pos=0.9 * truth.corner_pos),
    ):
        assert float(sum_of(implicit_loss(t, wrong, **options))) > 1.05 * everything
