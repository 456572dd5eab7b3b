"""What a model says accelerates an object over a measured toss, interval by interval."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tossid.motion import com_velocities, corner_velocities
from tossid.objects import ObjectModel, corner_heights
from tossid.physics import System, no_learned_acceleration, tree_batch
from tossid.physics.batch import free_accelerations
from tossid.physics.solvers import ConeProgramme, solve_contacts
from tossid.types import Phase, Toss

if TYPE_CHECKING:
    from tossid.models.implicit import LossWeights

Array = NDArray[np.float64]

GROUND_GAP = 2.0
"""Standard deviations of the corners' heights within which a corner counts as on the ground."""


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
    system: System, model: ObjectModel, toss: Toss, *, weights: LossWeights | None = None
) -> Accelerations:
    """The parts of a model's explanation of every measured interval (q, v) -> (q', v').

    given = g_z of k_hat; residual = e_z^T J_com a_res(q, v); contact = e_z^T J_com M^-1 J^T lam / dt with the
    impulses of ContactNets' inner problem (Pfrommer, Halm and Posa 2020), here in the model's own metric:

        lam = argmin 1/2 |dv - dt a - M^-1 J^T lam|²_M + w_c sum lam_n gap / dt
                     + w_d sum (mu lam_n |s| + lam_t . s)        over the friction cones, with s = J_t v'

    gap is phi' beyond `GROUND_GAP` gap scales and 0 below, in the ground too: a corner that noise lifts by a
    millimetre, or that has sunk as it landed, bears its load. (The loss uses |phi'|, because it asks whether a corner
    touches, not how much it bears.)

    Args:
        system: The learned simulator.
        model: The object that it simulates.
        toss: The toss as measured.
        weights: Weights of the inner problem's terms; the loss's defaults if None.
    """
    # loads torch, which figures of a diagnosis do not need
    from tossid.models.implicit import LossWeights

    weights = weights or LossWeights()
    n, dt = len(toss) - 1, np.diff(toss.t)
    q, v = toss.q[:-1], toss.v[:-1]
    acceleration = free_accelerations(system, q, v)
    a_res = acceleration - free_accelerations(system._replace(k_res=no_learned_acceleration(model.n_joints)), q, v)
    miss = np.diff(toss.v, axis=0) - dt[:, None] * acceleration

    J, J_com = _jacobian(corner_velocities, model, q), _jacobian(com_velocities, model, q)
    angular = tree_batch(system, q, v).X[:, :, :3]
    M = np.einsum("b,nbij,nbik->njk", model.mass, J_com, J_com)
    M += np.einsum("nbij,bik,nbkl->njl", angular, model.inertia, angular)

    gap = np.maximum(corner_heights(model, toss.q[1:]) - GROUND_GAP * weights.gap_scale, 0) / dt[:, None]
    sliding = np.einsum("ncij,nj->nci", J[:, :, :2], toss.v[1:])
    cost_n = weights.complementarity * gap + weights.dissipation * system.mu * np.linalg.norm(sliding, axis=-1)
    rows = np.concatenate([J[:, :, 2], J[:, :, :2].reshape(n, -1, system.nv)], axis=1)
    response = np.linalg.solve(M, np.swapaxes(rows, 1, 2))
    cost = np.concatenate([cost_n, weights.dissipation * sliding.reshape(n, -1)], axis=1)
    linear = cost - np.einsum("nij,nj->ni", rows, miss)
    lam = solve_contacts(rows @ response, linear, system.mu, solver=ConeProgramme()).lam
    pushed = np.einsum("nij,nj->ni", response, lam)

    def of_com(velocities: Array, q: Array) -> Array:
        """Vertical velocity of the common centre of mass; accelerations of a given posture go likewise."""
        return np.asarray(com_velocities(model, q, velocities)[..., 2] @ (model.mass / model.mass.sum()))

    separable = np.isin(toss.phase, (int(Phase.FLIGHT), int(Phase.IMPACT)))
    return Accelerations(
        t=toss.t[:-1] - toss.t[0] + 0.5 * dt,
        given=np.full(n, float(system.gravity[2])),
        residual=of_com(a_res, q),
        contact=of_com(pushed, q) / dt,
        measured=np.diff(of_com(toss.v, toss.q)) / dt,
        separable=separable[1:] & separable[:-1],
    )


def _jacobian(velocities: Callable[[ObjectModel, Array, Array], Array], model: ObjectModel, q: Array) -> Array:
    """(n, k, 3, nv) world Jacobian of k points whose velocities are linear in v, column by column."""
    columns = [velocities(model, q, np.tile(unit, (len(q), 1))) for unit in np.eye(model.nv)]
    return np.stack(columns, axis=-1)
