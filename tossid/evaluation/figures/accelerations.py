"""What a model says accelerates an object over a measured toss, interval by interval."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tossid.motion import com_velocities
from tossid.objects import ObjectModel, corner_heights
from tossid.physics import System, no_learned_acceleration, tree_batch
from tossid.physics.free import free_accelerations
from tossid.physics.solvers import solve_cone_qp
from tossid.rotations import skew
from tossid.settings.figures import FigureSettings
from tossid.types import Phase, Toss

if TYPE_CHECKING:
    from tossid.models.implicit import LossWeights

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Accelerations:
    """Vertical accelerations of the centre of mass over the n - 1 intervals of a toss, (n - 1,) [m/s²], up positive.

    Attributes:
        t: Middles of the intervals, from the toss's start [s].
        given: The part of the given continuous dynamics, k_hat.
        residual: The part of the learned acceleration, k_res.
        contact: The part of the contact impulses.
        measured: Difference of measured velocities over the interval.
        separable: False in sustained contact, where the data determine only the sum of k_res and contact.
    """

    t: Array
    given: Array
    residual: Array
    contact: Array
    measured: Array
    separable: NDArray[np.bool_]


def accelerations_over_toss(
    system: System,
    model: ObjectModel,
    toss: Toss,
    *,
    weights: LossWeights | None = None,
    settings: FigureSettings = FigureSettings(),
) -> Accelerations:
    """The parts of a model's explanation of every measured interval (q, v) -> (q', v').

    given = g_z of k_hat; residual = e_z^T J_com a_res(q, v); contact = e_z^T J_com M^-1 J^T lam / dt with the
    impulses of ContactNets' inner problem (Pfrommer, Halm and Posa 2020), here in the model's own metric:

        lam = argmin 1/2 |dv - dt a - M^-1 J^T lam|²_M + w_c sum lam_n gap / dt
                     + w_d sum (mu lam_n |s| + lam_t . s)        over the friction cones, with s = J_t v'

    gap is phi' beyond `settings.ground_gap` gap scales and 0 below, in the ground too: a corner that noise lifts by a
    millimetre, or that has sunk as it landed, bears its load. (The loss uses |phi'|, because it asks whether a corner
    touches, not how much it bears.)

    Args:
        system: The learned simulator.
        model: The object that it simulates.
        toss: The toss as measured.
        weights: Weights of the inner problem's terms; the loss's defaults if None.
        settings: From which height on a corner is above the ground.

    Returns:
        The accelerations.
    """
    # loads torch, which figures of a diagnosis do not need
    from tossid.models.implicit import LossWeights

    weights = weights or LossWeights()
    n, dt = len(toss) - 1, np.diff(toss.t)
    q, v = toss.q[:-1], toss.v[:-1]
    acceleration = free_accelerations(system, q, v)
    a_res = acceleration - free_accelerations(system._replace(k_res=no_learned_acceleration(model.n_joints)), q, v)
    M, J = _mass_and_jacobian(system, toss)
    miss = np.diff(toss.v, axis=0) - dt[:, None] * acceleration

    height = corner_heights(model, toss.q[1:])
    gap = np.maximum(height - settings.ground_gap * weights.gap_scale, 0) / dt[:, None]
    sliding = np.einsum("ncij,nj->nci", J[:, :, :2], toss.v[1:])
    speed = np.linalg.norm(sliding, axis=-1)
    cost_n = weights.complementarity * gap + weights.dissipation * system.mu * speed
    rows = np.concatenate([J[:, :, 2], J[:, :, :2].reshape(n, -1, system.nv)], axis=1)
    response = np.linalg.solve(M, np.swapaxes(rows, 1, 2))
    cost = np.concatenate([cost_n, weights.dissipation * sliding.reshape(n, -1)], axis=1)
    lam = solve_cone_qp(rows @ response, cost - np.einsum("nij,nj->ni", rows, miss), system.mu).lam
    pushed = np.einsum("nij,nj->ni", response, lam)

    # J_com takes v to the velocity of the centre of mass, and accelerations of a given posture likewise
    share = model.mass / model.mass.sum()
    separable = np.isin(toss.phase, (int(Phase.FLIGHT), int(Phase.IMPACT)))
    return Accelerations(
        t=toss.t[:-1] - toss.t[0] + 0.5 * dt,
        given=np.full(n, float(system.gravity[2])),
        residual=com_velocities(model, toss.q[:-1], a_res)[..., 2] @ share,
        contact=com_velocities(model, toss.q[:-1], pushed)[..., 2] @ share / dt,
        measured=np.diff(com_velocities(model, toss.q, toss.v)[..., 2] @ share) / dt,
        separable=separable[1:] & separable[:-1],
    )


def _mass_and_jacobian(system: System, toss: Toss) -> tuple[Array, Array]:
    """M (n - 1, nv, nv) and the corners' world Jacobians (n - 1, n_c, 3, nv) at the start of every interval."""
    tree = tree_batch(system, toss.q[:-1], toss.v[:-1])
    angular, linear = tree.X[:, :, :3], tree.X[:, :, 3:]
    at_com = linear - np.einsum("bij,nbjk->nbik", skew(system.com), angular)
    M = np.einsum("b,nbij,nbik->njk", system.mass, at_com, at_com)
    M += np.einsum("nbij,bik,nbkl->njl", angular, system.inertia, angular)
    body = system.corner_body
    local = linear[:, body] - np.einsum("cij,ncjk->ncik", skew(system.corner_pos), angular[:, body])
    return M, np.einsum("ncij,ncjk->ncik", tree.R[:, body], local)
