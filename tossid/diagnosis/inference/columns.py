"""Columns: how whitened residuals change with parameters, summed by toss. What follows from them needs no simulation.

With e the whitened residuals of toss i, J_i their derivatives by parameters and W_i Student's weights,

    H_i = J_i^T W_i J_i,    g_i = J_i^T W_i e_i,

a Gauss-Newton step is d = -(sum H)^-1 sum g. Leaving a toss out, a bootstrap, an effective score and a sandwich
covariance are sums of these over tosses. A column is a derivative (slope), or the whole change of the residuals to a
declared start (secant), whose coefficient is between 0 and 1.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.inference.evidence import Evidence
from tossid.diagnosis.inference.hypothesis import Hypothesis

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LARGEST = 1e3
"""Entry of a column beyond which contact, not the parameter, decides: standard deviations a step."""
RIDGE = 1e-9
"""Over the mean of the diagonal, so that a parameter that moves nothing has a step of zero."""
MOST_LEVERAGE, LEVERAGE_WINDOWS = 4.0, 10
"""Most information of one window over the 90 % quantile of those in which a column acts, and from how many of these."""
LONGEST_SECANT = 1.5
"""Largest multiple of the change to a declared start."""


@dataclass(frozen=True)
class Columns:
    """Sums over the windows of n tosses, of C columns.

    Attributes:
        H: (n, C, C) Gauss-Newton's Hessians.
        g: (n, C) gradients.
        curvature: Of Student's log-likelihood over Gauss-Newton's.
    """

    H: Array
    g: Array
    curvature: float

    @property
    def n(self) -> int:
        """How many tosses."""
        return len(self.g)

    def part(self, index: Sequence[int] | Index) -> Columns:
        """Some of the columns.

        Args:
            index: Their numbers.
        """
        index = np.asarray(index, dtype=int)
        return Columns(self.H[:, index[:, None], index], self.g[:, index], self.curvature)

    def scaled(self, factors: Array) -> Columns:
        """The columns times a factor each.

        Args:
            factors: (C,) these.
        """
        return Columns(self.H * factors[:, None] * factors, self.g * factors, self.curvature)

    def of_tosses(self, first: int, stop: int) -> Columns:
        """The columns of tosses from one to before another.

        Args:
            first: Number of the first.
            stop: Of the first after them.
        """
        return Columns(self.H[first:stop], self.g[first:stop], self.curvature)

    def step(self, weights: Array | None = None) -> Array:
        """(..., C) Gauss-Newton steps of weighted tosses.

        Args:
            weights: (..., n) of the tosses, such as how often each was drawn; once each if None.
        """
        weights = np.ones(self.n) if weights is None else weights
        H, g = np.einsum("...n,nij->...ij", weights, self.H), weights @ self.g
        return -_solve(H, g)

    def left_out(self) -> Array:
        """(n, C) steps of all tosses but one, for each."""
        return self.step(1.0 - np.eye(self.n))

    def gains(self, steps: Array) -> Array:
        """(n,) gain of each toss's log-likelihood by a step.

        Args:
            steps: (n, C) of each toss, or (C,) the same for all.
        """
        steps = np.broadcast_to(steps, self.g.shape)
        first, second = (self.g * steps).sum(1), np.einsum("ni,nij,nj->n", steps, self.H, steps)
        out: Array = -self.curvature * (first + 0.5 * second)
        return out

    def gain_of_step(self, fixed: Sequence[int], step: Array, others: Sequence[int]) -> float:
        """Gain of all tosses by a given step in some columns, where others follow.

        Args:
            fixed: Numbers of the columns that take the step.
            step: (len(fixed),) the step.
            others: Numbers of the columns that follow.
        """
        H, g = self.H.sum(0), self.g.sum(0)
        given = g[list(fixed)] @ step + 0.5 * step @ H[np.ix_(fixed, fixed)] @ step
        if others:
            slope = g[list(others)] + H[np.ix_(others, fixed)] @ step
            given -= 0.5 * slope @ _solve(H[np.ix_(others, others)], slope)
        return float(-self.curvature * given)

    def covariance(self) -> Array:
        """(C, C) covariance of a fit by the jackknife over tosses, in units of the columns' steps.

        Leaving tosses out in turn counts those of high leverage in full, where a sandwich of scores would not (CR3;
        Bell and McCaffrey, Survey Methodology 2002). No variance is below what noise alone gives, however alike the
        tosses are: the inverse of the curvature of Student's log-likelihood.
        """
        n, C = self.g.shape
        moved = self.left_out() - self.step()
        cov = (n - 1) / n * moved.T @ moved
        total = self.curvature * self.H.sum(0)
        bread = np.linalg.pinv(total + RIDGE * np.trace(total) / max(C, 1) * np.eye(C))
        return np.asarray(cov + np.diag(np.maximum(np.diag(bread) - np.diag(cov), 0.0)))

    def scores(self, own: Index, others: Index) -> tuple[Array, Array]:
        """Effective scores (n, C) of some columns, and their information (C, C): but for what others take of them.

        Args:
            own: (C,) numbers of the columns.
            others: Numbers of the columns that are fitted beside.
        """
        g, H = self.g[:, own], self.H.sum(0)
        information = H[np.ix_(own, own)]
        if not len(others):
            return g, information
        cross = _solve(H[np.ix_(others, others)], H[np.ix_(others, own)])
        return g - self.g[:, others] @ cross, information - H[np.ix_(own, others)] @ cross


def _solve(H: Array, g: Array) -> Array:
    """H^-1 g, with a small ridge: g (..., C) or (C, k)."""
    C = H.shape[-1]
    ridge = RIDGE * np.trace(H, axis1=-2, axis2=-1)[..., None, None] / max(C, 1) + 1e-12
    H = H + ridge * np.eye(C)
    if g.ndim == H.ndim:
        return np.asarray(np.linalg.solve(H, g))
    return np.asarray(np.linalg.solve(H, g[..., None])[..., 0])


def sums(evidence: Evidence, J: Array, n: int) -> Columns:
    """Columns of derivatives, summed by toss.

    Args:
        evidence: Of W windows.
        J: (W, L, K, C) changes of whitened residuals.
        n: How many tosses there are, of which some may have no windows.
    """
    w, density = evidence.windows, evidence.density
    nu, s = density.degrees_of_freedom, evidence.entry_scales()
    weight = np.where(w.inside[..., None], (nu + 1) / (nu + (evidence.residuals / s) ** 2) / s**2, 0.0)
    root = np.sqrt(weight)
    A = np.clip(np.nan_to_num(J), -LARGEST, LARGEST) * root[..., None]
    A *= _bounded_leverage((A**2).sum((1, 2)))[:, None, None, :]
    e = evidence.residuals * root
    C = A.shape[-1]
    H, g = np.zeros((n, C, C)), np.zeros((n, C))
    for i in range(n):
        rows = w.toss == i
        own = e[rows].ravel()
        flat = A[rows].reshape(len(own), C)
        H[i], g[i] = flat.T @ flat, own @ flat
    return Columns(H, g, density.curvature)


def _bounded_leverage(information: Array) -> Array:
    """(W, C) factors of columns, given each one's information (W, C) in each window.

    Where contact amplifies a parameter far beyond what it does elsewhere, derivatives hold in no neighbourhood, and one
    window would have all the weight (bounded influence; Krasker and Welsch, JASA 1982).
    """
    acts = information > 1e-6 * information.max(0, initial=0.0)
    out = np.ones_like(information)
    for c in np.flatnonzero(acts.sum(0) >= LEVERAGE_WINDOWS):
        most = MOST_LEVERAGE * np.quantile(information[acts[:, c], c], 0.9)
        out[:, c] = np.sqrt(most / np.maximum(information[:, c], most))
    return out


def slopes(evidence: Evidence, hypothesis: Hypothesis, which: Sequence[int], sizes: Array | None = None) -> Array:
    """(W, L, K, len(which)) derivatives of whitened residuals by parameters, in units of their steps.

    Args:
        evidence: At first states that suit the hypothesis, which may have more effects than the evidence's own.
        hypothesis: Where they are taken.
        which: Numbers of the parameters.
        sizes: (P,) widths of central differences, in steps; None for one-sided differences of one step.
    """
    flat, steps, (low, high) = hypothesis.flat(), hypothesis.steps, hypothesis.bounds
    J = np.empty((*evidence.residuals.shape, len(which)))
    here = None

    def residuals(j: int, value: float) -> Array:
        moved = flat.copy()
        moved[j] = value
        return evidence.residuals_of(hypothesis.at(moved))

    for k, j in enumerate(which):
        if sizes is None:
            if here is None:
                here = evidence.residuals_of(hypothesis)
            end = flat[j] + steps[j] if flat[j] + steps[j] <= high[j] else flat[j] - steps[j]
            J[..., k] = (residuals(j, end) - here) * (steps[j] / (end - flat[j]))
        else:
            ends = np.clip(flat[j] + np.array([-0.5, 0.5]) * sizes[j] * steps[j], low[j], high[j])
            J[..., k] = (residuals(j, ends[1]) - residuals(j, ends[0])) * (steps[j] / (ends[1] - ends[0]))
    return J
