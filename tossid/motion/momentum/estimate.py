"""Inertia and friction of a rigid body, or of bodies on joints, from `tossid.motion.momentum.balance`.

Least squares over all tosses, by Gauss and Newton. Standard errors are sandwich estimates with the toss as the unit, so
that what the balance leaves out widens them. A toss whose misfit is far above the others' counts less.

Estimates from differences of velocities are biased: noise in the change of spin, which multiplies inertia, makes
inertia too small (by 18 % for a tetrahedron with 2 mrad of noise). Here the measured poses have the errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from tossid.motion.momentum.balance import Balance
from tossid.objects import GRAVITY, ObjectModel
from tossid.physics.identifiable import inertia_about_com
from tossid.robust import huber_weights
from tossid.types import Toss

Array = NDArray[np.float64]

MOST_TOSSES = 48
"""Tosses, evenly drawn, that take part."""
FEWEST_SLIDING = 20
"""Intervals of steady sliding below which there is no estimate of friction."""
PRIOR = 0.5
"""Standard deviation of inertia (relative) and friction about their start, where tosses do not determine them."""
DIFFERENCE = 1e-3
"""Step of differences in inertia (relative) and friction."""
ITERATIONS, LARGEST_STEP, CONVERGED = 4, 0.3, 4e-3
"""Most Gauss-Newton steps, largest change in one of them, and relative change below which they end."""
OUTLIER = 2.0
"""Misfit, in medians over tosses, from which a toss counts less."""


@dataclass(frozen=True)
class Momentum:
    """What the balance of momentum shows.

    Attributes:
        inertia: (n_b, 3, 3) of each body about its centre of mass, in its frame [kg m²], for the stated masses.
        inertia_deviation: Largest standard error of a rigid body's second moments, relative. Of a tree, that of its
            kinetic energy about the common centre of mass.
        friction: Coulomb's coefficient of steady sliding; None where nothing slides.
        friction_deviation: Its standard error; infinite where nothing slides.
        sliding: Intervals between frames in which the body slides steadily.
    """

    inertia: Array
    inertia_deviation: float
    friction: float | None
    friction_deviation: float
    sliding: int


def momentum_balance(tosses: Sequence[Toss], model: ObjectModel, *, gravity: float = GRAVITY) -> Momentum:
    """Inertia and friction with which measured poses keep the balance of momentum.

    Where a few tosses determine the inertia so little that the filter breaks down, it is the model's, with the
    prior's standard error, and there is no friction.

    Args:
        tosses: Of one object over the ground z = 0.
        model: Its corners, joints, masses and centres of mass, which are taken as they are; its inertia and friction
            are the start.
        gravity: Of free flight, in recorded lengths [m/s²].
    """
    drawn = np.unique(np.linspace(0, len(tosses) - 1, min(len(tosses), MOST_TOSSES)).astype(int))
    balance = Balance([tosses[i] for i in drawn], model, gravity)
    try:
        inertia, deviation = _find_inertia(balance, model)
    except np.linalg.LinAlgError:  # a step so far that the filter's covariances lose their rank
        return Momentum(model.inertia, PRIOR, None, np.inf, 0)
    sliding = int(balance.sliding.any(-1).sum())
    mu, mu_deviation = None, np.inf
    if sliding >= FEWEST_SLIDING:
        mu, mu_deviation = _find_friction(balance, inertia, model.friction)
    return Momentum(inertia, deviation, mu, mu_deviation, sliding)


def _find_inertia(balance: Balance, model: ObjectModel) -> tuple[Array, float]:
    inertia = model.inertia
    for _ in range(ITERATIONS):
        x, _ = _gauss_newton(balance, inertia)
        x *= min(1.0, LARGEST_STEP / max(np.abs(x).max(), 1e-12))
        inertia = _scaled(inertia, x)
        if np.abs(x).max() < CONVERGED:
            break
    _, covs = _gauss_newton(balance, inertia)
    T = _energies(model, inertia)
    return inertia, float(np.sqrt(np.einsum("ij,cjk,ik->ci", T, covs, T).max()))


def _energies(model: ObjectModel, inertia: Array) -> Array:
    """Derivatives of a tree's kinetic energies, in logarithms, by the numbers of `_scaled`, (m, 6 n_b).

    At random joint positions, each along the principal motions of the mass matrix. Of a rigid body, the numbers are
    themselves those of its second moments.
    """
    if not model.n_joints:
        return np.eye(6)

    def about_com(x: Array) -> Array:
        return inertia_about_com(model.with_changes(inertia=_scaled(inertia, x)))

    steps = DIFFERENCE * np.eye(6 * model.n_bodies)
    size, motions = np.linalg.eigh(about_com(np.zeros(len(steps))))
    energies = [np.einsum("nim,nij,njm->nm", motions, about_com(step), motions) for step in steps]
    return np.stack([(energy / size - 1).ravel() / DIFFERENCE for energy in energies], axis=-1)


def _gauss_newton(balance: Balance, inertia: Array) -> tuple[Array, Array]:
    """A step in the numbers of `_scaled`, and covariances as of `_least_squares`."""
    balance.linearise(inertia)
    r = balance.residuals(inertia)
    steps = DIFFERENCE * np.eye(6 * len(inertia))
    J = np.stack([(balance.residuals(_scaled(inertia, step)) - r) / DIFFERENCE for step in steps], axis=-1)
    return _least_squares(r, J, balance.frames)


def _find_friction(balance: Balance, inertia: Array, mu: float) -> tuple[float, float]:
    covs, d = np.full((2, 1, 1), np.inf), DIFFERENCE
    for _ in range(ITERATIONS):
        r = balance.residuals(inertia, mu)
        J = (balance.residuals(inertia, mu + d) - r) / d
        step, covs = _least_squares(r, J[..., None], balance.frames)
        step = np.clip(step, -0.5 * mu, LARGEST_STEP)
        mu += float(step[0])
        if abs(step[0]) < CONVERGED * mu:
            break
    return mu, float(np.sqrt(covs.max()))


def _least_squares(r: Array, J: Array, frames: NDArray[np.int64]) -> tuple[Array, Array]:
    """A Gauss-Newton step (p,) and two covariances (2, p, p), from whitened residuals (n, b, nv), derivatives (…, p).

    Tosses with a large misfit count less. One covariance is as large as the scores of tosses scatter, the other as the
    noise of poses says. What the tosses do not determine stays where it is, and its error is that of the prior.
    """
    misfit = (r**2).sum(axis=(0, 2)) / frames
    weight = huber_weights(misfit, OUTLIER * float(np.median(misfit)))
    n, p = len(frames), J.shape[-1]
    H = np.einsum("b,kbip,kbiq->pq", weight, J, J)
    score = np.einsum("b,kbip,kbi->bp", weight, J, r)
    inverse, known = np.linalg.inv(H + np.eye(p) / PRIOR**2), np.eye(p) / PRIOR**2
    scatter = score.T @ score * n / max(1, n - p)
    covs = np.stack([inverse @ (part + known) @ inverse for part in (scatter, H)])
    return -inverse @ score.sum(axis=0), covs


def _scaled(inertia: Array, x: Array) -> Array:
    """Each body's inertia with second moments Σ = tr(I)/2 1 - I of L exp(X) Lᵀ, Σ = L Lᵀ; six numbers of X a body."""
    second = 0.5 * np.trace(inertia, axis1=1, axis2=2)[:, None, None] * np.eye(3) - inertia
    root = np.linalg.cholesky(second)
    a, b, c, d, e, f = x.reshape(-1, 6).T
    X = np.stack([np.stack(row, axis=-1) for row in ((a, d, e), (d, b, f), (e, f, c))], axis=-2)
    second = root @ expm(X) @ root.swapaxes(-1, -2)
    return np.asarray(np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second)
