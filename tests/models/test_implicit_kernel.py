"""The implicit loss's kernel: values and gradients against plain torch and finite differences; its inner problem."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.models import reference_implicit as reference
from tests.models.implicit_problems import WEIGHTS, assert_same, problem, sum_of
from tests.models.made import tosses
from tossid.models import implicit
from tossid.models.implicit import Dynamics, implicit_loss
from tossid.models.implicit_kernel import Contact, Problem, inner_problem
from tossid.models.implicit_motion import make_work
from tossid.models.transitions import make_transitions
from tossid.objects import ObjectModel


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("bodies", [1, 2, 4])
def test_values_and_gradients_are_those_of_torch(cube: ObjectModel, bodies: int, seed: int) -> None:
    t, d, options = problem(seed, cube, bodies=bodies)
    assert 0 < len(t.near) < len(t) or bodies > 1  # whose flight begins further from the ground
    assert_same(t, d, options)


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


def test_the_inner_problem_is_the_weighted_prediction_error_of_the_impulses(cube: ObjectModel) -> None:
    """A = J M^-1 W M^-1 J^T, and A lam + c is the gradient of the loss (times m) in the impulses."""
    t, d, options = problem(3, cube, bodies=2)
    metric, corner_body = options["metric"], options["corner_body"]
    n = int(t.near[0])
    parts = [part.detach() for part in d[:3]]
    work = make_work(implicit._bodies(*parts), implicit._bodies(*metric), d.corner_pos.detach().numpy())
    weights = (WEIGHTS.complementarity, WEIGHTS.dissipation, WEIGHTS.penetration, WEIGHTS.gap_scale)
    contact = Contact(corner_body.numpy(), float(d.mu.detach()), *weights)
    stated = Problem(implicit._kinematics(t), d.gravity.detach().numpy(), implicit._a_res(d, t), contact)
    A, c = inner_problem(stated, n, work)

    row = t.rows(torch.tensor([n]))
    J = reference.corner_jacobian(row, corner_body, d.corner_pos.detach())[0]
    M, W = (reference.mass_matrix(row, *numbers)[0] for numbers in (parts, metric))
    J = J[:, [2, 0, 1]].reshape(-1, J.shape[-1])  # contact-major, the normal first
    response = torch.linalg.solve(M, J.mT)
    expected = (response.mT @ W @ response).numpy()
    np.testing.assert_allclose(A, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())
    a = reference.free_acceleration(row, d._replace(a_res=None if d.a_res is None else d.a_res[n : n + 1]))[1][0]
    residual = row.dv[0] - row.dt[0] * a.detach()
    without_costs = -(response.mT @ W @ residual).numpy()
    phi = reference.next_phi(row, corner_body, d.corner_pos.detach())[0]
    gap = ((phi.square() + WEIGHTS.gap_scale**2).sqrt() - WEIGHTS.gap_scale) / row.dt[0]
    velocity = (J @ row.v_next[0]).reshape(-1, 3)
    speed = velocity[:, 1:].norm(dim=1)
    costs = torch.cat(
        [
            (WEIGHTS.complementarity * gap + WEIGHTS.dissipation * d.mu.detach() * speed)[:, None],
            WEIGHTS.dissipation * velocity[:, 1:],
        ],
        dim=1,
    )
    np.testing.assert_allclose(c, without_costs + costs.reshape(-1).numpy(), rtol=1e-9, atol=1e-9)


def test_the_true_dynamics_have_no_loss_in_flight_and_next_to_none_in_contact(cube: ObjectModel) -> None:
    """Tosses of the time-stepping simulator satisfy its own equations; a gap within a step costs a little."""
    t = make_transitions(cube, tosses(cube, 3, seed=4))
    metric = tuple(torch.as_tensor(part) for part in (cube.mass, cube.mass[:, None] * cube.com, cube.inertia))
    truth = Dynamics(
        *metric,
        torch.as_tensor(cube.corner_pos),
        torch.tensor(cube.friction, dtype=torch.float64),
        torch.tensor([0.0, 0.0, -9.81], dtype=torch.float64),
        None,
    )
    options = {"corner_body": torch.as_tensor(cube.corner_body), "metric": metric, "weights": WEIGHTS}
    flight = implicit_loss(t.in_flight(), truth, **options)
    assert float(flight.prediction) < 1e-16
    everything = float(sum_of(implicit_loss(t, truth, **options)))
    for wrong in (
        truth._replace(mu=0.5 * truth.mu),
        truth._replace(gravity=0.9 * truth.gravity),
        truth._replace(corner_pos=1.1 * truth.corner_pos),
        truth._replace(corner_pos=0.9 * truth.corner_pos),
    ):
        assert float(sum_of(implicit_loss(t, wrong, **options))) > 1.05 * everything
