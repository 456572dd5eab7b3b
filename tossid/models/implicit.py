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
heights count quadratically: sqrt(phi'² + c²) - c with c = `gap_scale`. `docs/method/loss.md` explains each term.

The four terms are those of Pfrommer, Halm and Posa, "ContactNets: Learning Discontinuous Contact Dynamics with Smooth,
Implicit Representations", CoRL 2020 (arXiv 2009.11193), and of Bianchini, Halm and Posa, "Simultaneous Learning of
Contact and Continuous Dynamics", CoRL 2023 (arXiv 2310.12054). Metric, units and the smoothed gap are our own.

At the minimiser, the gradient of the loss is that of the objective with the impulses held (envelope theorem). So torch
differentiates through everything but the solver. Held are lam_n and beta = lam_t / mu: in these, the cone |beta| <=
lam_n does not depend on mu.

Generalised velocities have their linear part in the axes of the base here (`Transitions` has it in the world's). There,
M does not depend on how the base stands: of a rigid body it is one matrix for all transitions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from tossid.errors import InputError
from tossid.models.transitions import Transitions
from tossid.objects import Roundness
from tossid.physics.solvers import ConeProgramme, solve_contacts

SMALLEST_SPEED = 1e-8
"""Added to sliding speeds in quadrature [m/s], so that |s| has a derivative at rest."""

AT_ONCE = 1024
"""Inner problems whose matrices are in memory at once."""


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


class Bodies(NamedTuple):
    """Inertial parameters of a tree's bodies; the mass matrix is linear in them.

    Attributes:
        mass: (n_b,) [kg].
        moment: (n_b, 3) mass times centre of mass, from the body's origin [kg m].
        inertia: (n_b, 3, 3) about the body's origin [kg m²].
    """

    mass: Tensor
    moment: Tensor
    inertia: Tensor


class Dynamics(NamedTuple):
    """A model's numbers, as tensors that may carry gradients.

    Attributes:
        bodies: Inertial parameters.
        corner_pos: (n_c, 3) in the bodies' frames [m].
        mu: () friction.
        gravity: (3,) of k_hat, world axes [m/s²].
        a_res: (N, nv) learned acceleration, linear part in the base's axes; None for none.
    """

    bodies: Bodies
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


def implicit_loss(
    t: Transitions,
    d: Dynamics,
    *,
    corner_body: Tensor,
    metric: Bodies,
    weights: LossWeights,
    roundness: Roundness | None = None,
) -> LossTerms:
    """The loss's terms; differentiable in `d`.

    Args:
        t: N transitions, K of which may involve contact.
        d: The model's numbers.
        corner_body: (n_c,) body of each corner.
        metric: The given bodies, for W.
        weights: Of the terms.
        roundness: What stands at the corners; None for points.

    Raises:
        InputError: The friction is negative.
    """
    if float(d.mu.detach()) < 0:
        raise InputError(f"friction of {float(d.mu.detach())}; expected at least 0")
    X, near, dt, v_next = base_jacobian(t), t.near, t.dt[t.near, None], in_base_axes(t, t.v_next)[t.near]
    M_inverse, W = inverse(mass_matrix(X, d.bodies)), mass_matrix(X, metric)
    residual = in_base_axes(t, t.dv) - t.dt[:, None] * _acceleration(t, d, X, M_inverse)
    corners = make_corners(t, X, d.corner_pos, corner_body, roundness)
    depth = corners.next_heights().clamp(max=0.0) / dt

    # Impulses are found without gradients, and the loss is that of the objective at these impulses, with gradients.
    with torch.no_grad():
        gap, sliding, speed = _gap_and_sliding(corners, v_next, dt, weights)
        cost_n = weights.complementarity * gap + weights.dissipation * d.mu * speed
        cost = torch.cat([weights.dissipation * sliding, cost_n[..., None]], dim=-1)
        lam, unsolved = _impulses(corners, select(M_inverse, near), select(W, near), residual[near], cost, d.mu)
        hit = torch.nonzero(lam[..., 2].any(dim=1)).flatten()
        lam_n, beta = lam[hit, :, 2], lam[hit, :, :2] / d.mu.clamp(min=torch.finfo(lam.dtype).tiny)
    corners, lam_t = corners.rows(hit), d.mu * beta
    impulse = corners.generalized(torch.cat([lam_t, lam_n[..., None]], dim=-1))
    residual = residual.index_add(0, near[hit], times(select(M_inverse, near[hit]), impulse), alpha=-1)
    gap, sliding, speed = _gap_and_sliding(corners, v_next[hit], dt[hit], weights)
    slip = d.mu * lam_n * speed + (lam_t * sliding).sum(-1)
    n, total = len(t), metric.mass.sum()
    return LossTerms(
        prediction=0.5 * (residual * times(W, residual)).sum() / (total * n),
        complementarity=weights.complementarity * (lam_n * gap).sum() / (total * n),
        dissipation=weights.dissipation * slip.sum() / (total * n),
        penetration=0.5 * weights.penetration * depth.square().sum() / n,
        unsolved=unsolved,
    )


def _gap_and_sliding(
    corners: Corners, v_next: Tensor, dt: Tensor, weights: LossWeights
) -> tuple[Tensor, Tensor, Tensor]:
    """Smoothed gaps |phi'| / dt (K, n_c), sliding velocities s (K, n_c, 2) and speeds |s| (K, n_c) [m/s]."""
    phi = corners.next_heights()
    gap = ((phi.square() + weights.gap_scale**2).sqrt() - weights.gap_scale) / dt
    sliding = corners.velocities(v_next)[..., :2]
    return gap, sliding, (sliding.square().sum(-1) + SMALLEST_SPEED**2).sqrt()


def free_acceleration(t: Transitions, d: Dynamics) -> Tensor:
    """The free acceleration a = M^-1 k_hat + a_res (N, nv), linear part in the world's axes.

    Args:
        t: The transitions.
        d: The model's numbers.
    """
    X = base_jacobian(t)
    a = _acceleration(t, d, X, inverse(mass_matrix(X, d.bodies)))
    return torch.cat([(t.R[:, 0] @ a[:, :3, None])[..., 0], a[:, 3:]], dim=-1)


def _impulses(
    corners: Corners, M_inverse: Tensor, W: Tensor, residual: Tensor, cost: Tensor, mu: Tensor
) -> tuple[Tensor, int]:
    """Impulses that solve the inner problem (K, n_c, 3), the normal last [N s], and how many have no solution.

    The inner problem is min over the cones of 1/2 lam^T A lam + c^T lam with A = J M^-1 W M^-1 J^T. Where
    c_n >= mu |c_t| at all corners the impulses are zero, whatever A is.
    """
    c = cost - corners.velocities(times(M_inverse, times(W, residual)))
    pressed = torch.nonzero(~(c[..., 2] >= mu * c[..., :2].norm(dim=-1)).all(dim=1)).flatten()
    lam, unsolved, count = torch.zeros_like(c), 0, c.shape[1]
    root = M_inverse @ torch.linalg.cholesky(W)  # A = (J root) (J root)^T
    for rows in pressed.split(AT_ONCE):
        J = corners.rows(rows).jacobian(select(root, rows))
        J = torch.cat([J[:, 2], J[:, :2].transpose(1, 2).flatten(1, 2)], dim=1)  # the solver's order: normals first
        linear = torch.cat([c[rows, :, 2], c[rows, :, :2].flatten(1)], dim=1)
        problem = (J @ J.mT).numpy(), linear.numpy(), np.full(count, float(mu))
        found = solve_contacts(*problem, solver=ConeProgramme())
        solution, unsolved = torch.from_numpy(found.lam), unsolved + found.unsolved
        lam[rows] = torch.cat([solution[:, count:].unflatten(1, (count, 2)), solution[:, :count, None]], dim=-1)
    return lam, unsolved


class Corners(NamedTuple):
    """Corners in K transitions that may involve contact, in the order of their bodies.

    Attributes:
        X: (1 or K, 6 n_b, nv) the bodies' Jacobians, of `base_jacobian`.
        R: (K, n_b, 3, 3) the bodies' rotations before the step.
        up_next: (K, n_b, 3) the world's vertical in the bodies' axes after the step.
        z_next: (K, n_b) height of the bodies' origins after the step [m].
        places: (n_b) corners of each body (n, 3) in its axes [m].
        offsets: (n_b) of round corners, their lowest points from there before and after the step, each (K, n, 3) [m].
    """

    X: Tensor
    R: Tensor
    up_next: Tensor
    z_next: Tensor
    places: tuple[Tensor, ...]
    offsets: tuple[tuple[Tensor, Tensor], ...] | None

    def rows(self, index: Tensor) -> Corners:
        """Those of some transitions."""
        offsets = self.offsets and tuple((before[index], after[index]) for before, after in self.offsets)
        state = (select(self.X, index), self.R[index], self.up_next[index], self.z_next[index])
        return Corners(*state, self.places, offsets)

    def next_heights(self) -> Tensor:
        """phi(q') (K, n_c) [m]; of a round corner, that of its point that is lowest then."""
        found = []
        for b, place in enumerate(self.places):
            height = self.z_next[:, b, None] + self.up_next[:, b] @ place.mT
            if self.offsets is not None:
                height = height + (self.offsets[b][1] @ self.up_next[:, b, :, None])[..., 0]
            found.append(height)
        return torch.cat(found, dim=1)

    def velocities(self, v: Tensor) -> Tensor:
        """Velocities J v of the corners (K, n_c, 3), world axes, at velocities v (K, nv)."""
        found, twists = [], times(self.X, v).unflatten(1, (-1, 6))
        for b, place in enumerate(self.places):
            spin, linear = twists[:, b, None, :3], twists[:, b, None, 3:]
            local = linear + torch.einsum("ki,cij->kcj", spin[:, 0], skew(place))  # w x r = -r^ w
            if self.offsets is not None:
                local = local + torch.linalg.cross(spin, self.offsets[b][0])
            found.append(local @ self.R[:, b].mT)
        return torch.cat(found, dim=1)

    def generalized(self, impulses: Tensor) -> Tensor:
        """J^T lam (K, nv) of impulses on the corners (K, n_c, 3), world axes."""
        wrenches = []
        for b, of_body in enumerate(impulses.split([len(place) for place in self.places], dim=1)):
            local = of_body @ self.R[:, b]
            torque = torch.einsum("cij,kcj->ki", skew(self.places[b]), local)
            if self.offsets is not None:
                torque = torque + torch.linalg.cross(self.offsets[b][0], local).sum(dim=1)
            wrenches += [torque, local.sum(dim=1)]
        return times(self.X.mT, torch.cat(wrenches, dim=1))

    def jacobian(self, C: Tensor) -> Tensor:
        """J C (K, 3, n_c, m) of matrices C (1 or K, nv, m); the second axis is that of the world's axes."""
        found, twists = [], (self.X @ C).unflatten(1, (-1, 6))
        for b, place in enumerate(self.places):
            spin, linear = twists[:, b, :3], twists[:, b, None, 3:]
            local = linear - torch.einsum("cij,njm->ncim", skew(place), spin)
            if self.offsets is not None:
                local = local - skew(self.offsets[b][0]) @ spin[:, None]
            found.append((self.R[:, b] @ local.transpose(1, 2).flatten(2)).unflatten(2, (len(place), -1)))
        return torch.cat(found, dim=2)


def make_corners(
    t: Transitions, X: Tensor, corner_pos: Tensor, corner_body: Tensor, roundness: Roundness | None
) -> Corners:
    """The corners in the transitions that may involve contact.

    A round corner is hit where it is lowest before the step; the gap is at its lowest point after it.

    Args:
        t: The transitions.
        X: Of `base_jacobian`.
        corner_pos: (n_c, 3) [m].
        corner_body: (n_c,).
        roundness: What stands at the corners; None for points.
    """
    R, up_next, offsets = t.R[t.near], t.up_next[t.near], None
    corners_of = [torch.nonzero(corner_body == b).flatten() for b in range(R.shape[1])]
    if roundness is not None:
        before, after = (
            torch.from_numpy(roundness.offset(-up[:, corner_body].numpy())) for up in (R[..., 2, :], up_next)
        )
        offsets = tuple((before[:, index], after[:, index]) for index in corners_of)
    return Corners(select(X, t.near), R, up_next, t.z_next[t.near], tuple(corner_pos[i] for i in corners_of), offsets)


def base_jacobian(t: Transitions) -> Tensor:
    """The bodies' Jacobians (N, 6 n_b, nv) for velocities whose linear part is in the base's axes.

    Of a single body it is the same in all transitions, and has one row (1, 6, 6).
    """
    X = t.X[:1] if t.X.shape[1] == 1 else t.X
    R = t.R[: len(X), None, 0]
    return torch.cat([X[..., :3] @ R, X[..., 3:]], dim=-1).flatten(1, 2)


def in_base_axes(t: Transitions, v: Tensor) -> Tensor:
    """Velocities (N, nv) with their linear part in the base's axes in place of the world's."""
    return torch.cat([(v[:, None, :3] @ t.R[:, 0])[:, 0], v[:, 3:]], dim=-1)


def mass_matrix(X: Tensor, bodies: Bodies) -> Tensor:
    """M (n, nv, nv) = sum over bodies of X^T [[I, h^], [-h^, m 1]] X, with first moments h.

    Args:
        X: (n, 6 n_b, nv), of `base_jacobian`.
        bodies: Inertial parameters.
    """
    h = skew(bodies.moment)
    mass = bodies.mass[:, None, None] * torch.eye(3, dtype=h.dtype)
    spatial = torch.cat([torch.cat([bodies.inertia, h], dim=2), torch.cat([-h, mass], dim=2)], dim=1)
    return X.mT @ (spatial @ X.unflatten(1, (-1, 6))).flatten(1, 2)


def inverse(M: Tensor) -> Tensor:
    """The inverse of matrices (n, nv, nv); NaN of those that are not positive definite."""
    factor, info = torch.linalg.cholesky_ex(M)
    return torch.cholesky_inverse(factor.masked_fill(info[:, None, None] > 0, torch.nan))


def _acceleration(t: Transitions, d: Dynamics, X: Tensor, M_inverse: Tensor) -> Tensor:
    """The free acceleration (N, nv), linear part in the base's axes.

    k_hat is gravity less Coriolis, centrifugal and gyroscopic forces (Newton and Euler, about the bodies' origins).
    """
    m, h, I = d.bodies
    acc, w = t.xdd - (d.gravity @ t.R), t.omega
    h = h.expand_as(w)
    cross = torch.linalg.cross
    linear = m[:, None] * acc + cross(t.alpha, h) + cross(w, cross(w, h))
    angular = (I @ t.alpha[..., None])[..., 0] + cross(w, (I @ w[..., None])[..., 0]) + cross(h, acc)
    a = -times(M_inverse, times(X.mT, torch.cat([angular, linear], dim=-1).flatten(1)))
    return a if d.a_res is None else a + d.a_res


def times(A: Tensor, x: Tensor) -> Tensor:
    """A x for each of K vectors x (K, c), with one matrix for all, A (1, r, c), or one for each (K, r, c)."""
    return x @ A[0].mT if len(A) == 1 else (A @ x[..., None])[..., 0]


def select(A: Tensor, rows: Tensor) -> Tensor:
    """The matrices of some transitions; the one matrix (1, r, c) that holds for all stays."""
    return A if len(A) == 1 else A[rows]


def skew(x: Tensor) -> Tensor:
    """x^ (*b, 3, 3) with x^ y = x × y, of x (*b, 3)."""
    a, b, c = x.unbind(-1)
    zero = torch.zeros_like(a)
    return torch.stack([zero, -c, b, c, zero, -a, -b, a, zero], dim=-1).unflatten(-1, (3, 3))
