"""Fitting the parameters of effects to whitened misses, toss by toss robustly.

The likelihood (`evidence`) is climbed by Gauss-Newton with its density's weights (iteratively reweighted least
squares), derivatives by differences of whole predictions. The windows' first states follow in every step (variable
projection, Golub and Pereyra 1973): states that fit another world hold a fit back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from tossid.diagnosis.evidence import FREE, NU, Evidence, Hypothesis, gains

Array = NDArray[np.float64]

CURVATURE = 0.65
"""Of Student's log-likelihood on Gaussian misses, over the weighted squares that Gauss-Newton has of it."""
ITERATIONS = 8
CONVERGED = 0.05
"""Change in standard errors at which a fit ends."""
ENOUGH = 0.05
"""Gain of log-likelihood at which a fit ends."""
NARROWEST, WIDEST = 0.5, 8.0
"""Of differences, in steps: contact is rough at scales that the tosses cannot resolve."""
LEVERAGE = 4.0
"""Most information of a window, over the 90 % quantile of those in which a parameter acts."""
FEWEST_ACTING = 10
DOUBLINGS = 3
NUDGED = 6
"""Directions in which a fit is nudged."""
FARTHEST = 16.0
"""Standard errors that a nudge takes at most."""
TRIALS = 5
"""Dampings that are tried in an iteration."""


@dataclass(frozen=True)
class Fitted:
    """A fitted hypothesis, the evidence as it is there, and Gauss-Newton's sums, toss by toss, in units of the
    parameters' steps."""

    hypothesis: Hypothesis
    evidence: Evidence
    residual: Array
    scales: Array
    H: Array
    g: Array

    def of_part(self, part: NDArray[np.bool_]) -> Hypothesis:
        """The hypothesis at the values that the tosses of a part (n,) alone would have, to one Gauss-Newton step.

        The fit is taken as the best for all: where it ended on a rough slope, that slope is every toss's alike.
        """
        flat = self.hypothesis.flat()
        if not len(flat):
            return self.hypothesis
        low, high = self.hypothesis.bounds
        H, g = self.H[part].sum(0), (self.g - self.g.mean(0))[part].sum(0)
        delta = -np.linalg.pinv(H + 1e-9 * np.trace(H) * np.eye(len(flat))) @ g
        return self.hypothesis.at(np.clip(flat + np.clip(delta, -50, 50) * self.hypothesis.steps, low, high))

    def scatter(self, name: str) -> tuple[float, float]:
        """How far tosses are apart in an effect's values, for evidence of free flight.

        Returns:
            Squared, over what noise makes: the median over tosses of what a Gauss-Newton step for that toss alone would
            gain, over the median of chi-squared; about 1 for what is the same in all. And what is beyond noise, over
            what the effect itself is to a toss: about the square of its values' standard deviation over their mean.
        """
        names = [effect.name for effect in self.hypothesis.effects for _ in effect.parameters]
        own = [j for j, each in enumerate(names) if each == name]
        weights = self.evidence.windows.weights
        weight = np.bincount(self.evidence.windows.toss, weights=weights, minlength=len(self.g))
        count = np.bincount(self.evidence.windows.toss, minlength=len(self.g))
        H, g = self.H[:, own][:, :, own], self.g[:, own]
        told = (count > 0) & (np.einsum("nii->n", H) > 0)
        if not told.any():
            return 0.0, 0.0
        # misses beyond noise are here what is asked about, and no reason to trust misses less
        trust = (self.scales[FREE] ** 2 * count[told] / weight[told])[:, None, None]
        H, g = trust * H[told], trust[..., 0] * g[told]
        size = np.einsum("ni,nij,nj->n", g, np.linalg.pinv(H, hermitian=True), g)
        noise = float(chi2.ppf(0.5, len(own)))
        effect = next(effect for effect in self.hypothesis.effects if effect.name == name)
        nothing = effect.nominal(self.hypothesis.minus(name).world())
        away = (self.hypothesis.values_of(name) - nothing) / self.hypothesis.steps[own]
        whole = max(float(np.median(np.einsum("i,nij,j->n", away, H, away))), 1e-12)
        return float(np.median(size)) / noise, max(float(np.median(size)) - noise, 0.0) / whole

    def covariance(self) -> Array:
        """Sandwich over tosses (P, P), in the parameters' own units.

        Its bread is the likelihood's own curvature, which is less than Gauss-Newton's.
        """
        n, size = self.g.shape
        total = CURVATURE * self.H.sum(0)
        bread = np.linalg.pinv(total + 1e-9 * np.trace(total) / max(size, 1) * np.eye(size))
        centred = self.g - self.g.mean(0)
        meat = centred.T @ centred * n / max(n - size, 1)
        cov = bread @ meat @ bread
        # no better than the noise allows, however alike the tosses' slopes are
        cov += np.diag(np.maximum(np.diag(bread) - np.diag(cov), 0.0))
        steps = self.hypothesis.steps
        return cov * np.outer(steps, steps)


def derivatives(
    evidence: Evidence,
    hypothesis: Hypothesis,
    residual: Array,
    which: Sequence[int] | None = None,
    sizes: Array | None = None,
) -> Array:
    """(W, L, K, P) of the whitened misses by the parameters, a step each; those not in `which` are 0.

    Args:
        sizes: (P,) of central differences, in steps; None for one-sided ones of a step.
    """
    flat, steps = hypothesis.flat(), hypothesis.steps
    low, high = hypothesis.bounds

    def at(j: int, value: float) -> Array:
        moved = flat.copy()
        moved[j] = value
        return evidence.residual(hypothesis.at(moved).world())

    J = np.zeros((*residual.shape, len(flat)))
    for j in range(len(flat)) if which is None else which:
        if sizes is None:
            up = flat[j] + steps[j] if flat[j] + steps[j] <= high[j] else flat[j] - steps[j]
            J[..., j] = (at(j, up) - residual) * (steps[j] / (up - flat[j]))
        else:
            ends = np.clip(flat[j] + np.array([-0.5, 0.5]) * sizes[j] * steps[j], low[j], high[j])
            J[..., j] = (at(j, ends[1]) - at(j, ends[0])) * (steps[j] / (ends[1] - ends[0]))
    return J


def toss_sums(evidence: Evidence, residual: Array, J: Array, scales: Array, n_tosses: int) -> tuple[Array, Array]:
    """Gauss-Newton's H (n, P, P) and g (n, P) of each toss, with Student's weights.

    A window's leverage is bounded (as Krasker and Welsch do, JASA 1982): where contact amplifies a parameter beyond
    what it does elsewhere, derivatives hold nowhere but there, and one such window would have all the weight.
    """
    w = evidence.windows
    s = evidence.spread(scales)
    weight = (NU + 1) / (NU + (residual / s) ** 2) / s**2
    weight = np.where(w.inside[..., None], weight, 0.0)
    H_w = np.einsum("wlc,wlci,wlcj->wij", weight, J, J, optimize=True)
    g_w = np.einsum("wlc,wlci,wlc->wi", weight, J, residual, optimize=True)
    share = _leverage(np.einsum("wii->wi", H_w)) * evidence.windows.weights
    H_w, g_w = H_w * share[:, None, None], g_w * share[:, None]
    H, g = np.zeros((n_tosses, *H_w.shape[1:])), np.zeros((n_tosses, g_w.shape[1]))
    np.add.at(H, w.toss, H_w)
    np.add.at(g, w.toss, g_w)
    return H, g


def _leverage(size: Array) -> Array:
    """(W,) weights of windows of which each parameter's information is `size` (W, P)."""
    share = np.ones(len(size))
    for column in size.T:
        acts = column > 1e-6 * column.max(initial=0.0)
        if acts.sum() >= FEWEST_ACTING:
            most = LEVERAGE * np.quantile(column[acts], 0.9)
            share = np.minimum(share, most / np.maximum(column, most))
    return share


def fit(
    evidence: Evidence,
    start: Hypothesis,
    *,
    n_tosses: int,
    iterations: int = ITERATIONS,
    held: frozenset[str] = frozenset(),
) -> Fitted:
    """Fit a hypothesis's parameters, and the windows' first states with them.

    Args:
        evidence: around a hypothesis near by.
        start: values to begin with.
        held: names of effects whose values stay as they are.
    """
    hypothesis, steps = start, start.steps
    names = [effect.name for effect in start.effects for _ in effect.parameters]
    free = [j for j, name in enumerate(names) if name not in held]
    low, high = start.bounds
    evidence = evidence.renewed(start.world())
    residual = evidence.residual(start.world())
    scales = evidence.scales(residual)
    damping, stale, sizes = 1e-3, True, np.full(len(steps), WIDEST)
    for _ in range(iterations if free else 0):
        if stale:
            J = derivatives(evidence, hypothesis, residual, free, sizes)
            H, g = toss_sums(evidence, residual, J, scales, n_tosses)
            sizes = _difference_sizes(H)
        total, slope = H.sum(0), g.sum(0)
        before = evidence.log_likelihood(residual, scales)
        gained = partial(_gained, evidence, scales, before)
        for _ in range(TRIALS):
            lhs = total + damping * np.diag(np.diag(total)) + 1e-9 * max(np.trace(total), 1e-12) * np.eye(len(steps))
            delta = np.clip(-np.linalg.solve(lhs, slope), -100, 100)
            moved = hypothesis.at(np.clip(hypothesis.flat() + delta * steps, low, high))
            trial = evidence.residual(moved.world())
            better = gained(trial) > 0
            if better:
                break
            damping = max(damping, 1e-2) * 8
        if not better:
            break
        for _ in range(DOUBLINGS):
            # states that have not followed yet hold a step back
            further = hypothesis.at(np.clip(2 * moved.flat() - hypothesis.flat(), low, high))
            beyond = evidence.residual(further.world())
            if not gained(beyond) > gained(trial):
                break
            moved, trial = further, beyond
        there = evidence.renewed(moved.world())
        renewed = there.residual(moved.world())
        # from the states of before, and from those that suit the step
        plain = there.log_likelihood(there.residual(hypothesis.world()), scales)
        followed = gains(there.log_likelihood(renewed, scales), plain) @ there.windows.weights
        gain = 0.5 * (gained(trial) + float(followed))
        if gain <= 0:
            # better around the states of before only
            damping, stale = max(damping, 1e-2) * 30, False
            continue
        change = np.abs(moved.flat() - hypothesis.flat()) / steps * np.sqrt(np.maximum(np.diag(total), 0.0))
        hypothesis, evidence, residual, stale = moved, there, renewed, True
        scales = np.minimum(scales, evidence.scales(residual))
        damping *= 0.2
        if gain < ENOUGH or change.max() < CONVERGED:
            break
    J = derivatives(evidence, hypothesis, residual, free, sizes)
    H, g = toss_sums(evidence, residual, J, scales, n_tosses)
    return Fitted(hypothesis, evidence, residual, evidence.scales(residual), H, g)


def nudged(fitted: Fitted) -> tuple[Evidence, Hypothesis]:
    """A fitted hypothesis moved on along the directions that its likelihood says least of, by one standard error and
    more, as long as that is better with first states that have followed, and the evidence there.

    Steps of a fit are judged around first states that suit what they start from; there contact may hold a parameter
    where no likelihood does.
    """
    evidence, hypothesis, scales = fitted.evidence, fitted.hypothesis, fitted.scales
    low, high = hypothesis.bounds
    size = np.sqrt(np.maximum(np.diagonal(fitted.H.sum(0)), 1e-12))
    information, directions = np.linalg.eigh(fitted.H.sum(0) / np.outer(size, size))
    weights = evidence.windows.weights

    def ll(e: Evidence, h: Hypothesis) -> Array:
        return e.log_likelihood(e.residual(h.world()), scales)

    now = ll(evidence, hypothesis)
    for i in range(min(len(size), NUDGED)):
        # along an eigenvector of the correlations, a standard error long
        move = directions[:, i] / np.sqrt(max(information[i], 1e-9)) / size * hypothesis.steps
        for way in (move, -move):
            length = 1.0
            while length <= FARTHEST:
                moved = hypothesis.at(np.clip(hypothesis.flat() + length * way, low, high))
                there = evidence.renewed(moved.world(), refine=3)
                after = np.maximum(ll(there, moved), ll(evidence, moved))
                if not gains(after, np.maximum(now, ll(there, hypothesis))) @ weights > ENOUGH:
                    break
                hypothesis, evidence, now, length = moved, there, ll(there, moved), 2 * length
    return evidence, hypothesis


def _gained(evidence: Evidence, scales: Array, before: Array, residual: Array) -> float:
    return float(gains(evidence.log_likelihood(residual, scales), before) @ evidence.windows.weights)


def _difference_sizes(H: Array) -> Array:
    """(P,) of central differences, in steps: two standard errors either way, over which curvature is to hold."""
    return np.clip(4.0 / np.sqrt(np.maximum(np.diagonal(H.sum(0)), 1e-12)), NARROWEST, WIDEST)
