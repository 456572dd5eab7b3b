"""The implicit, violation-based loss of ContactNets, with its inner problem solved exactly.

For one transition (q, v) -> (q', v') of length dt, with dv = v' - v, the model's free acceleration
a = M^-1 k_hat + a_res, the corners' signed distances phi' = phi(q'), contact Jacobians J = J(q) and sliding velocities
s = J_t v':

    loss = min over lam in the friction cones of
           1/2 |dv - dt a - M^-1 J^T lam|²_W                      prediction
         + w_c / dt  sum lam_n |phi'|                             complementarity
         + w_d       sum (mu lam_n |s| + lam_t . s)               maximum dissipation
         + w_p / 2   m (min(phi', 0) / dt)²                       penetration

all in joules, divided by the object's mass m. |x|²_W is x^T W x, where W is the given mass matrix, also where inertia
is learned: with the learned one, shrinking it would lower the loss by itself. Of |phi'|, values below the noise of
heights count quadratically: sqrt(phi'² + c²) - c with c = `gap_scale`.

The four terms are those of Pfrommer, Halm and Posa, "ContactNets: Learning Discontinuous Contact Dynamics with Smooth,
Implicit Representations", CoRL 2020 (arXiv 2009.11193), and of Bianchini, Halm and Posa, "Simultaneous Learning of
Contact and Continuous Dynamics", CoRL 2023 (arXiv 2310.12054). Metric, units and the smoothed gap are our own.

At the minimiser, the gradient of the loss is that of the objective with lam_n and beta = lam_t / mu held (envelope
theorem; in these, the cone does not depend on mu). So nothing differentiates through the solver, and loss and gradient
come from one pass of a kernel over the transitions (`implicit_kernel`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from tossid.errors import InputError
from tossid.models.implicit_kernel import Contact, Problem, Sums, inner_problem, loss_sums
from tossid.models.implicit_motion import Array, Kinematics, Work, accelerations, make_work
from tossid.models.transitions import Transitions
from tossid.physics.contact.rounds import Points, Shape
from tossid.physics.solvers import SolverStatus, solve_cone_qp
from tossid.physics.solvers.problem import DEFAULT_TOLERANCE

Rows = NDArray[np.integer[Any]]

MAX_ITERATIONS = 60
"""Of the quick solver of the inner problem; a problem that it does not solve is given to `solve_cone_qp`."""


@dataclass(frozen=True)
class LossWeights:
    """Weights of the loss's terms (prediction has weight 1).

    Attributes:
        complementarity: w_c.
        dissipation: w_d.
        penetration: w_p.
        gap_scale: Distance below which a gap counts quadratically [m].
    """

    complementarity: float = 1.0
    dissipation: float = 100.0
    penetration: float = 0.1
    gap_scale: float = 1e-3


class Dynamics(NamedTuple):
    """A model's numbers, as tensors that may carry gradients.

    Attributes:
        mass: (n_b,) [kg].
        moment: (n_b, 3) mass times centre of mass, from the body's origin [kg m].
        inertia: (n_b, 3, 3) about the body's origin [kg m²].
        corner_pos: (n_c, 3) in the bodies' frames [m].
        mu: () friction.
        gravity: (3,) of k_hat [m/s²].
        a_res: (N, nv) learned acceleration in the base's frame, or None.
    """

    mass: Tensor
    moment: Tensor
    inertia: Tensor
    corner_pos: Tensor
    mu: Tensor
    gravity: Tensor
    a_res: Tensor | None


class LossTerms(NamedTuple):
    """Each term's mean over the transitions () [m²/s²], and how many inner problems have no solution."""

    prediction: Tensor
    complementarity: Tensor
    dissipation: Tensor
    penetration: Tensor
    unsolved: int


def free_acceleration(t: Transitions, d: Dynamics) -> Tensor:
    """The free acceleration a = M^-1 k_hat + a_res (N, nv), without gradients.

    Args:
        t: The transitions.
        d: The model's numbers.
    """
    out = np.empty(t.v.shape)
    body = _bodies(*d[:3])
    accelerations(_kinematics(t), _array(d.gravity), _a_res(d, t), make_work(body, body, np.zeros((0, 3))), out)
    return torch.from_numpy(out)


def implicit_loss(
    t: Transitions,
    d: Dynamics,
    *,
    corner_body: Tensor,
    metric: tuple[Tensor, Tensor, Tensor],
    weights: LossWeights,
    shape: Shape = Points(),
) -> LossTerms:
    """The loss's terms; differentiable (once) in `d`.

    Args:
        t: The transitions.
        d: The model's numbers.
        corner_body: (n_c,) body of each corner.
        metric: Given mass, moment and inertia, for W.
        weights: Of the terms.
        shape: What stands at the corners.

    Raises:
        InputError: The friction is negative.
    """
    learned = [x is not None and torch.is_grad_enabled() and x.requires_grad for x in d]
    inertial, touching = any(learned[:3]) or learned[5], any(learned[3:5])
    mu = float(d.mu.detach())
    if mu < 0:
        raise InputError(f"friction of {mu}; expected at least 0")
    problem = Problem(
        _kinematics(t),
        _array(d.gravity),
        _a_res(d, t),
        Contact(
            corner_body.numpy(),
            mu,
            complementarity=float(weights.complementarity),
            dissipation=float(weights.dissipation),
            penetration=float(weights.penetration),
            gap_scale=float(weights.gap_scale),
            shape=shape,
        ),
    )
    n, nc = len(t), len(d.corner_pos)
    sums = _zero_sums(t, nc, with_a_res=learned[6])
    work = make_work(_bodies(*d[:3]), _bodies(*metric), _array(d.corner_pos))

    def add(rows: Rows, given: Array) -> Rows:
        return loss_sums(problem, rows, given, DEFAULT_TOLERANCE, MAX_ITERATIONS, work, sums, inertial, touching)

    status = add(np.arange(n), np.zeros((0, 3 * nc)))
    again = np.flatnonzero(status == SolverStatus.MAX_ITERATIONS)
    unsolved = int(np.count_nonzero(status)) - len(again)
    if len(again):
        lam, left = _solve_again(again, problem, work)
        add(again, lam)
        unsolved += left
    gradients = [x / n if want else None for x, want in zip(sums[1:], learned, strict=True)]
    terms = _Known.apply(torch.from_numpy(sums.terms) / n, gradients, *d)
    return LossTerms(terms[0], terms[1], terms[2], terms[3], unsolved)


class _Known(torch.autograd.Function):
    """The four terms, with gradients that are known beforehand: of the prediction alone, or with a first axis of 4."""

    @staticmethod
    def forward(ctx: Any, terms: Tensor, gradients: list[Array | None], *inputs: Tensor | None) -> Tensor:
        ctx.gradients = [None if g is None else torch.from_numpy(g) for g in gradients]
        return terms.clone()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, slope: Tensor) -> tuple[Tensor | None, ...]:
        """Chain rule."""
        by_term = (False, False, False, True, True, False, False)
        out: list[Tensor | None] = [None, None]
        for g, four in zip(ctx.gradients, by_term, strict=True):
            out.append(g if g is None else torch.tensordot(slope, g, 1) if four else slope[0] * g)
        return tuple(out)


def _solve_again(rows: Rows, problem: Problem, work: Work) -> tuple[Array, int]:
    """Impulses (K, 3 n_c), contact-major, where the quick solver gave up, and how many stayed unsolved."""
    n = len(work.Q)
    order = np.concatenate([np.arange(0, 3 * n, 3), np.arange(3 * n).reshape(n, 3)[:, 1:].ravel()])
    lam, unsolved = np.empty((len(rows), 3 * n)), 0
    for k, row in enumerate(rows.tolist()):
        A, c = inner_problem(problem, row, work)
        solution = solve_cone_qp(A[None][:, order][:, :, order], c[None, order], np.full(n, problem.contact.mu))
        lam[k, order] = solution.lam[0]
        unsolved += solution.unsolved
    return lam, unsolved


def _array(x: Tensor) -> Array:
    return np.ascontiguousarray(x.detach().numpy())


def _bodies(mass: Tensor, moment: Tensor, inertia: Tensor) -> Array:
    """(n_b, 13): mass, moment, inertia."""
    return _array(torch.cat([mass[:, None], moment, inertia.flatten(1)], dim=1))


def _zero_sums(t: Transitions, n_corners: int, *, with_a_res: bool) -> Sums:
    n, n_bodies, _, nv = t.X.shape
    bodies = ((n_bodies,), (n_bodies, 3), (n_bodies, 3, 3))
    shapes = ((4,), *bodies, (4, n_corners, 3), (4,), (3,), (n if with_a_res else 0, nv))
    return Sums._make(np.zeros(shape) for shape in shapes)


def _a_res(d: Dynamics, t: Transitions) -> Array:
    """(N, nv), or no rows."""
    return np.zeros((0, t.v.shape[1])) if d.a_res is None else _array(d.a_res)


def _kinematics(t: Transitions) -> Kinematics:
    near = np.zeros(len(t), dtype=np.bool_)
    near[t.near.numpy()] = True
    return Kinematics._make([*(_array(getattr(t, name)) for name in Kinematics._fields[:-1]), near])
