"""Random transitions and numbers for the implicit loss, and its comparison with the reference in torch."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.models import reference_implicit as reference
from tests.physics.trees import random_tree
from tossid.models import implicit
from tossid.models.implicit import Dynamics, LossWeights, implicit_loss
from tossid.models.transitions import Transitions, make_transitions
from tossid.objects import ObjectModel, corner_positions
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


def sum_of(terms: implicit.LossTerms) -> Tensor:
    return terms.prediction + terms.complementarity + terms.dissipation + terms.penetration
