"""The implicit loss: what it gives gradients for, what it solves again, and what it refuses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch

from tests.models import reference_implicit as reference
from tests.models.implicit_problems import TERMS, assert_same, problem, sum_of
from tossid.errors import InputError
from tossid.models import implicit
from tossid.models.implicit import Dynamics, implicit_loss
from tossid.objects import ObjectModel
from tossid.physics.solvers import ContactSolution, solve_cone_qp


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
