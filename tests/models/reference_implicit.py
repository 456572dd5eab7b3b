"""The implicit loss in plain torch, transition by transition, differentiated by torch: what the kernel is held to."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from tossid.models.implicit import Dynamics, LossWeights
from tossid.models.transitions import Transitions
from tossid.physics.solvers import solve_cone_qp


class LossTerms(NamedTuple):
    """Each term per transition (N,) [m²/s²]; unsolved counts inner problems without a solution."""

    prediction: Tensor
    complementarity: Tensor
    dissipation: Tensor
    penetration: Tensor
    unsolved: int


def skew(x: Tensor) -> Tensor:
    """x^ (*b, 3, 3) with x^ y = x × y, of x (*b, 3)."""
    zero = torch.zeros_like(x[..., 0])
    a, b, c = x.unbind(-1)
    rows = [zero, -c, b, c, zero, -a, -b, a, zero]
    return torch.stack(rows, dim=-1).reshape(*x.shape, 3)


def mass_matrix(t: Transitions, mass: Tensor, moment: Tensor, inertia: Tensor) -> Tensor:
    """M(q) (N, nv, nv), linear in the inertial parameters."""
    h = skew(moment)
    top = torch.cat([inertia, h], dim=-1)
    bottom = torch.cat([-h, mass[:, None, None] * torch.eye(3, dtype=mass.dtype)], dim=-1)
    spatial = torch.cat([top, bottom], dim=-2)
    return torch.einsum("nbij,bik,nbkl->njl", t.X, spatial, t.X)


def force(t: Transitions, mass: Tensor, moment: Tensor, inertia: Tensor, gravity: Tensor) -> Tensor:
    """k(q, v) (N, nv): gravity less Coriolis, centrifugal and gyroscopic forces (Newton-Euler)."""
    acc = t.xdd - torch.einsum("nbij,i->nbj", t.R, gravity)
    w, h = t.omega, moment.expand_as(t.omega)
    linear = mass[:, None] * acc + torch.cross(t.alpha, h, dim=-1)
    linear = linear + torch.cross(w, torch.cross(w, h, dim=-1), dim=-1)
    Iw = torch.einsum("bij,nbj->nbi", inertia, w)
    angular = torch.einsum("bij,nbj->nbi", inertia, t.alpha) + torch.cross(w, Iw, dim=-1)
    angular = angular + torch.cross(h, acc, dim=-1)
    return -torch.einsum("nbij,nbi->nj", t.X, torch.cat([angular, linear], dim=-1))


def a_res_in_order_of_v(t: Transitions, a_res: Tensor) -> Tensor:
    """A learned acceleration (N, nv) from the base's frame to the order of v (linear part in the world)."""
    linear = torch.einsum("nij,nj->ni", t.R[:, 0], a_res[:, :3])
    return torch.cat([linear, a_res[:, 3:]], dim=-1)


def free_acceleration(t: Transitions, d: Dynamics) -> tuple[Tensor, Tensor]:
    """M (N, nv, nv) and a = M^-1 k + a_res (N, nv)."""
    M = mass_matrix(t, d.mass, d.moment, d.inertia)
    a = torch.linalg.solve(M, force(t, d.mass, d.moment, d.inertia, d.gravity))
    if d.a_res is not None:
        a = a + a_res_in_order_of_v(t, d.a_res)
    return M, a


def corner_jacobian(t: Transitions, corner_body: Tensor, corner_pos: Tensor) -> Tensor:
    """World Jacobian of every corner (N, n_c, 3, nv)."""
    angular, linear = t.X[:, corner_body, :3], t.X[:, corner_body, 3:]
    local = linear - torch.einsum("cij,ncjk->ncik", skew(corner_pos), angular)
    return torch.einsum("ncij,ncjk->ncik", t.R[:, corner_body], local)


def next_phi(t: Transitions, corner_body: Tensor, corner_pos: Tensor) -> Tensor:
    """phi(q') (N, n_c) [m]."""
    return t.z_next[:, corner_body] + torch.einsum("ncj,cj->nc", t.up_next[:, corner_body], corner_pos)


def implicit_loss(
    t: Transitions, d: Dynamics, *, corner_body: Tensor, metric: tuple[Tensor, Tensor, Tensor], weights: LossWeights
) -> LossTerms:
    """The loss's terms for every transition; differentiable in `d`.

    Args:
        t: transitions.
        d: the model's numbers.
        corner_body: (n_c,) body of each corner.
        metric: given mass, moment, inertia, for W.
        weights: of the terms.
    """
    M, a = free_acceleration(t, d)
    W = mass_matrix(t, *metric)
    total = metric[0].sum()
    miss = t.dv - t.dt[:, None] * a

    near = t.rows(t.near)
    J = corner_jacobian(near, corner_body, d.corner_pos)
    phi = next_phi(near, corner_body, d.corner_pos)
    sliding = torch.einsum("ncij,nj->nci", J[:, :, :2], near.v_next)
    speed = (sliding.square().sum(-1) + 1e-16).sqrt()
    gap = ((phi.square() + weights.gap_scale**2).sqrt() - weights.gap_scale) / near.dt[:, None]

    M_near, W_near, miss_near = M[t.near], W[t.near], miss[t.near]
    with torch.no_grad():
        cost_n = weights.complementarity * gap + weights.dissipation * d.mu * speed
        lam_n, lam_t, unsolved = _inner(J, M_near, W_near, miss_near, cost_n, weights.dissipation * sliding, d.mu)

    # with lam_t = mu beta and |beta| <= lam_n, the feasible set does not move with mu: beta is what is held
    lam_t = d.mu * (lam_t / d.mu.detach())

    push = torch.einsum("nci,ncij->nj", torch.cat([lam_t, lam_n[..., None]], dim=-1), J)
    miss_near = miss_near - torch.linalg.solve(M_near, push)
    miss = miss.index_copy(0, t.near, miss_near)

    def spread(values: Tensor) -> Tensor:
        return torch.zeros(len(t), dtype=values.dtype).index_copy(0, t.near, values)

    depth = torch.clamp(phi, max=0.0) / near.dt[:, None]
    return LossTerms(
        prediction=0.5 * torch.einsum("ni,nij,nj->n", miss, W, miss) / total,
        complementarity=spread(weights.complementarity * (lam_n * gap).sum(-1) / total),
        dissipation=spread(weights.dissipation * (d.mu * lam_n * speed + (lam_t * sliding).sum(-1)).sum(-1) / total),
        penetration=spread(0.5 * weights.penetration * depth.square().sum(-1)),
        unsolved=unsolved,
    )


def _inner(
    J: Tensor, M: Tensor, W: Tensor, miss: Tensor, cost_n: Tensor, cost_t: Tensor, mu: Tensor
) -> tuple[Tensor, Tensor, int]:
    """lam* of the inner problem: lam_n (K, n_c), lam_t (K, n_c, 2) [N s], and how many stayed unsolved."""
    K, n, _, nv = J.shape
    rows = torch.cat([J[:, :, 2], J[:, :, :2].reshape(K, 2 * n, nv)], dim=1)
    response = torch.linalg.solve(M, rows.mT)  # M^-1 J^T
    weighted = response.mT @ W
    A = weighted @ response
    c = -(weighted @ miss[..., None])[..., 0] + torch.cat([cost_n, cost_t.reshape(K, 2 * n)], dim=1)
    friction = torch.broadcast_to(mu, (K, n)).contiguous()
    solution = solve_cone_qp(A.numpy(), c.numpy(), friction.numpy())
    lam = torch.from_numpy(solution.lam)
    return lam[:, :n], lam[:, n:].reshape(K, n, 2), solution.unsolved
