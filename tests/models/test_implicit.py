"""The implicit loss's kernel: values and gradients against plain torch, and against finite differences."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.models import reference_implicit as reference
from tests.physics.trees import random_tree
from tossid.errors import InputError
from tossid.models import implicit
from tossid.models.implicit import Dynamics, LossWeights, free_acceleration, implicit_loss
from tossid.models.transitions import Transitions, make_transitions
from tossid.objects import ObjectModel, corner_positions
from tossid.physics.solvers import ContactSolution, solve_cone_qp
from tossid.types import Toss

TERMS = ("prediction", "complementarity", "dissipation", "penetration")
WEIGHTS = LossWeights(complementarity=0.7, dissipation=0.3, penetration=1.3, gap_scale=2e-3)


def made_up(model: ObjectModel, rng: np.random.Generator, *, count: int = 60) -> Transitions:
    """Random states that touch the ground, sink into it, or are above it, with velocities that no dynamics connects."""
    q = np.zeros((count, model.nq))
    q[:, 3:] = rng.normal(size=(count, model.nq - 3))
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    lowest = corner_positions(model, q)[..., 2].min(axis=1)
    q[:, 2] += rng.uniform(-0.05, 0.3, count) * model.width - lowest
    v = rng.normal(size=(count, model.nv))
    v[1:] = 0.6 * v[:-1] + 0.4 * v[1:]
    zero, phase = np.zeros((count, model.nv, model.nv)), np.zeros(count, dtype=np.uint8)
    return make_transitions(model, [Toss("made up", np.arange(count) / 148, q, v, zero, zero, phase)])


def random_numbers(model: ObjectModel, rng: np.random.Generator, n: int, *, a_res: bool) -> Dynamics:
    """Numbers far from the object's: centres of mass off the origins, full inertia, tilted gravity."""
    points = model.width * rng.normal(size=(model.n_bodies, 20, 3)) + 0.2 * model.width
    mass = model.mass * rng.uniform(0.5, 2.0, model.n_bodies)
    second = np.einsum("b,bpi,bpj->bij", mass / 20, points, points)
    inertia = np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second
    parts = (
        mass,
        mass[:, None] * points.mean(axis=1),
        inertia,
        model.corner_pos + 0.05 * model.width * rng.normal(size=model.corner_pos.shape),
        np.array(rng.uniform(0.05, 0.8)),
        np.array([0.0, 0.0, -9.81]) + rng.normal(size=3),
    )
    accelerations = torch.from_numpy(rng.normal(size=(n, model.nv))).requires_grad_() if a_res else None
    return Dynamics(*(torch.from_numpy(part).requires_grad_() for part in parts), accelerations)


def problem(seed: int, cube: ObjectModel, *, bodies: int) -> tuple[Transitions, Dynamics, dict[str, Any]]:
    rng = np.random.default_rng(seed)
    model = cube if bodies == 1 else random_tree(rng, n_bodies=bodies)
    t = made_up(model, rng)
    metric = tuple(part.detach() for part in random_numbers(model, rng, 0, a_res=False)[:3])
    d = random_numbers(model, rng, len(t), a_res=seed % 3 != 0)
    return t, d, {"corner_body": torch.as_tensor(model.corner_body), "metric": metric, "weights": WEIGHTS}


def assert_same(t: Transitions, d: Dynamics, options: dict[str, Any]) -> None:
    """Every term, and every term's gradient in all numbers."""
    found, expected = implicit_loss(t, d, **options), reference.implicit_loss(t, d, **options)
    assert found.unsolved == expected.unsolved
    numbers = [x for x in d if x is not None]
    for name in TERMS:
        value, truth = getattr(found, name), getattr(expected, name).mean()
        assert float(truth.detach()) > 0
        assert float(value.detach()) == pytest.approx(float(truth.detach()), rel=1e-10)
        gradients = torch.autograd.grad(value, numbers, retain_graph=True, materialize_grads=True)
        truths = torch.autograd.grad(truth, numbers, retain_graph=True, materialize_grads=True)
        for gradient, expected_gradient in zip(gradients, truths, strict=True):
            scale = float(expected_gradient.abs().max())
            torch.testing.assert_close(gradient, expected_gradient, rtol=1e-8, atol=1e-8 * scale)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("bodies", [1, 2, 4])
def test_values_and_gradients_are_those_of_torch(cube: ObjectModel, bodies: int, seed: int) -> None:
    t, d, options = problem(seed, cube, bodies=bodies)
    assert 0 < len(t.near) < len(t) or bodies > 1  # whose flight begins further from the ground
    assert_same(t, d, options)


def test_what_the_quick_solver_leaves_is_solved_again(cube: ObjectModel, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def counted(*args: Any) -> ContactSolution:
        asked.append(len(args[0]))
        return solve_cone_qp(*args)

    monkeypatch.setattr(implicit, "MAX_ITERATIONS", 0)
    monkeypatch.setattr(implicit, "solve_cone_qp", counted)
    t, d, options = problem(7, cube, bodies=2)
    assert_same(t, d, options)
    assert sum(asked) > 10


def test_only_what_is_learned_gets_a_gradient(cube: ObjectModel) -> None:
    t, d, options = problem(1, cube, bodies=2)
    full = torch.autograd.grad(sum_of(implicit_loss(t, d, **options)), list(d))
    for wanted in range(len(d)):
        some = Dynamics(*(x.detach().requires_grad_(i == wanted) for i, x in enumerate(d)))
        (gradient,) = torch.autograd.grad(sum_of(implicit_loss(t, some, **options)), [some[wanted]])
        torch.testing.assert_close(gradient, full[wanted], rtol=1e-12, atol=0)
    with torch.no_grad():
        assert not sum_of(implicit_loss(t, d, **options)).requires_grad


def test_gradients_by_differences(cube: ObjectModel) -> None:
    t, d, options = problem(2, cube, bodies=2)
    rng = np.random.default_rng(0)
    gradients = torch.autograd.grad(sum_of(implicit_loss(t, d, **options)), list(d))
    for i, (number, gradient) in enumerate(zip(d, gradients, strict=True)):
        direction = torch.from_numpy(np.array(rng.normal(size=number.shape)))
        if i == 2:
            direction = direction + direction.mT
        step = 1e-6 * number.detach().abs().max() * direction
        above, below = (
            sum_of(implicit_loss(t, Dynamics(*d[:i], number.detach() + sign * step, *d[i + 1 :]), **options)).detach()
            for sign in (1, -1)
        )
        assert float((gradient * step).sum()) == pytest.approx(float(above - below) / 2, rel=1e-5)


def test_free_acceleration(cube: ObjectModel) -> None:
    t, d, _ = problem(4, cube, bodies=3)
    torch.testing.assert_close(
        free_acceleration(t, d), reference.free_acceleration(t, d)[1].detach(), rtol=1e-9, atol=0
    )


def test_numbers_that_are_no_body_are_not_repaired(cube: ObjectModel) -> None:
    t, d, options = problem(5, cube, bodies=1)
    broken = implicit_loss(t, d._replace(inertia=-d.inertia), **options)
    assert not torch.isfinite(broken.prediction)
    assert broken.unsolved == len(t.near)
    with pytest.raises(InputError, match="friction"):
        implicit_loss(t, d._replace(mu=torch.tensor(-0.1, dtype=torch.float64)), **options)


def test_no_friction(cube: ObjectModel) -> None:
    t, d, options = problem(6, cube, bodies=1)
    d = d._replace(mu=torch.tensor(0.0, dtype=torch.float64))
    loss = sum_of(implicit_loss(t, d, **options))
    slightly = sum_of(implicit_loss(t, d._replace(mu=d.mu + 1e-7), **options))
    assert float(loss.detach()) == pytest.approx(float(slightly.detach()), rel=1e-4)


def test_transitions_without_contact(cube: ObjectModel) -> None:
    t, d, options = problem(1, cube, bodies=1)
    above = replace(t, near=t.near[:0])
    found, expected = implicit_loss(above, d, **options), reference.implicit_loss(above, d, **options)
    assert float(found.prediction.detach()) == pytest.approx(float(expected.prediction.mean().detach()), rel=1e-12)
    assert [float(getattr(found, name).detach()) for name in TERMS[1:]] == [0.0, 0.0, 0.0]


def sum_of(terms: implicit.LossTerms) -> Tensor:
    return terms.prediction + terms.complementarity + terms.dissipation + terms.penetration
