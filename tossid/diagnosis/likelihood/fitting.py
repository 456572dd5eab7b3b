"""Fitting the parameters of effects to whitened residuals.

The likelihood (`evidence`) is maximised by damped Gauss-Newton steps with the weights of Student's density (iteratively
reweighted least squares); derivatives are differences of whole predictions. The windows' first states are estimated
anew after every step (variable projection, Golub and Pereyra 1973): states that fit another world hold a fit back.

The step and its damping are those of `tossid.least_squares`. The loop around them is its own: a step is accepted by
robust gains of log-likelihood at first states both before and after they have followed, and the whitening changes with
them. No loop for a fixed residual function does that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from tossid.diagnosis.likelihood.derivatives import Derivatives, derivatives
from tossid.diagnosis.likelihood.evidence import FREE, Evidence, Hypothesis
from tossid.least_squares import Damping, damped_step, search_damping
from tossid.settings.diagnosis.likelihood import EffectFitSettings

Array = NDArray[np.float64]
SCHEDULE = Damping(grow=8.0, fall=0.2, least=1e-2)
"""Of Marquardt's damping: it changes how soon a fit ends, not where."""


@dataclass(frozen=True)
class Fitted:
    """A fitted hypothesis, with n tosses' sums of Gauss-Newton in units of the P parameters' steps.

    Attributes:
        hypothesis: At the fitted values.
        evidence: There.
        residuals: (W, L, K) whitened, there.
        scales: (N_PHASES,) there.
        H: (n, P, P) each toss's Hessian.
        g: (n, P) each toss's gradient.
    """

    hypothesis: Hypothesis
    evidence: Evidence
    residuals: Array
    scales: Array
    H: Array
    g: Array

    def of_part(self, part: NDArray[np.bool_]) -> Hypothesis:
        """The hypothesis at the values that some tosses alone would have, to one Gauss-Newton step.

        The fit is taken as the optimum for all: where it ended on a rough slope, that slope is subtracted from every
        toss's.

        Args:
            part: (n,) which tosses.
        """
        flat = self.hypothesis.flat()
        if not len(flat):
            return self.hypothesis
        H, g = self.H[part].sum(0), (self.g - self.g.mean(0))[part].sum(0)
        delta = -np.linalg.pinv(H + 1e-9 * np.trace(H) * np.eye(len(flat))) @ g
        return self.hypothesis.clipped(flat + np.clip(delta, -50, 50) * self.hypothesis.steps)

    def gain_of(self, other: Hypothesis) -> float:
        """What another hypothesis gains in log-likelihood at this one's first states, limited by window.

        Args:
            other: The other hypothesis.
        """
        before, after = (
            self.evidence.log_likelihood_of(each.world(), self.scales) for each in (self.hypothesis, other)
        )
        return float(self.evidence.gains(after, before).sum())

    def scatter(self, name: str) -> tuple[float, float]:
        """How much an effect's values scatter from toss to toss, for evidence of free flight.

        Args:
            name: Of the effect.

        Returns:
            Two squares. The first is over noise: the median over tosses of what a Gauss-Newton step for that toss alone
            would gain, over the median of chi-squared; about 1 for what is the same in all tosses. The second is what
            is beyond noise, over what the effect itself contributes to a toss: about the square of its values' standard
            deviation over their mean.
        """
        own = [j for j, owner in enumerate(self.hypothesis.parameter_owners) if owner == name]
        windows = self.evidence.windows
        weight = np.bincount(windows.toss, weights=windows.weights, minlength=len(self.g))
        count = np.bincount(windows.toss, minlength=len(self.g))
        H, g = self.H[:, own][:, :, own], self.g[:, own]
        informed = (count > 0) & (np.einsum("nii->n", H) > 0)
        if not informed.any():
            return 0.0, 0.0
        # scatter is the question here, so residuals beyond noise are no reason to weigh them less
        scale = (self.scales[FREE] ** 2 * count[informed] / weight[informed])[:, None, None]
        H, g = scale * H[informed], scale[..., 0] * g[informed]
        gain = np.einsum("ni,nij,nj->n", g, np.linalg.pinv(H, hermitian=True), g)
        noise = float(chi2.ppf(0.5, len(own)))
        effect = self.hypothesis.effects[self.hypothesis.names.index(name)]
        nominal = effect.nominal(self.hypothesis.minus(name).world())
        size = (self.hypothesis.values_of(name) - nominal) / self.hypothesis.steps[own]
        whole = max(float(np.median(np.einsum("i,nij,j->n", size, H, size))), 1e-12)
        return float(np.median(gain)) / noise, max(float(np.median(gain)) - noise, 0.0) / whole

    def loss_by_noise(self, name: str, folds: Sequence[NDArray[np.bool_]]) -> Array:
        """(n,) what an effect that is fitted to noise loses in log-likelihood on held-out tosses, on average.

        That is half of d^T H d, where d are its values minus those that change nothing. It holds near these. Of effects
        that are also sought from declared starts it is not known, and 0.

        Args:
            name: Of the effect.
            folds: (n,) each, the tosses that are held out in turn.
        """
        hypothesis, out = self.hypothesis, np.zeros(len(self.H))
        effect = hypothesis.effects[hypothesis.names.index(name)]
        if effect.starts:
            return out
        own, nominal = hypothesis.place_of(name), effect.nominal(hypothesis.minus(name).world())
        for held in folds:
            d = (self.of_part(~held).flat()[own] - nominal) / hypothesis.steps[own]
            out[held] = np.einsum("i,nij,j->n", d, self.H[held][:, own, own], d)
        return 0.5 * self.evidence.density.curvature * out

    def covariance(self) -> Array:
        """(P, P) sandwich estimate over tosses, in the parameters' own units.

        The bread is the curvature of Student's log-likelihood, which is less than Gauss-Newton's.
        """
        n, size = self.g.shape
        total = self.evidence.density.curvature * self.H.sum(0)
        bread = np.linalg.pinv(total + 1e-9 * np.trace(total) / max(size, 1) * np.eye(size))
        centred = self.g - self.g.mean(0)
        meat = centred.T @ centred * n / max(n - size, 1)
        cov = bread @ meat @ bread
        # no variance below what noise alone gives, however alike the tosses' slopes are
        cov += np.diag(np.maximum(np.diag(bread) - np.diag(cov), 0.0))
        steps = self.hypothesis.steps
        return cov * np.outer(steps, steps)


def toss_sums(evidence: Evidence, residuals: Array, J: Array, scales: Array, n_tosses: int) -> tuple[Array, Array]:
    """Each toss's Hessian (n, P, P) and gradient (n, P) of Gauss-Newton, with Student's weights.

    A window's leverage is bounded (Krasker and Welsch, JASA 1982). Where contact amplifies a parameter far beyond what
    it does elsewhere, derivatives hold in no neighbourhood, and one such window would have all the weight.

    Args:
        evidence: Of W windows.
        residuals: (W, L, K) whitened.
        J: (W, L, K, P) their derivatives.
        scales: (N_PHASES,) of the phases.
        n_tosses: n, of which windows may be missing.
    """
    w, weight = evidence.windows, _entry_weights(evidence, residuals, scales)
    H_w = np.einsum("wlc,wlci,wlcj->wij", weight, J, J, optimize=True)
    g_w = np.einsum("wlc,wlci,wlc->wi", weight, J, residuals, optimize=True)
    share = _bounded_leverage(np.einsum("wii->wi", H_w), w.settings.fit) * w.weights
    H_w, g_w = H_w * share[:, None, None], g_w * share[:, None]
    H, g = np.zeros((n_tosses, *H_w.shape[1:])), np.zeros((n_tosses, g_w.shape[1]))
    np.add.at(H, w.toss, H_w)
    np.add.at(g, w.toss, g_w)
    return H, g


def standard_errors(evidence: Evidence, residuals: Array, J: Array, scales: Array) -> Array:
    """Standard errors that noise gives to a fit of each parameter alone, with the weights of `toss_sums`.

    Args:
        evidence: Of W windows.
        residuals: (W, L, K) whitened.
        J: (W, L, K, P) their derivatives, by the parameters' steps.
        scales: (N_PHASES,) of the phases.

    Returns:
        (P,) in the parameters' steps; infinite for a parameter that moves nothing.
    """
    w, weight = evidence.windows, _entry_weights(evidence, residuals, scales)
    information = np.einsum("wlc,wlci->wi", weight, J**2, optimize=True)
    share = _bounded_leverage(information, w.settings.fit) * w.weights
    spread, total = np.sqrt(share**2 @ information), share @ information
    return np.where(total > 0, spread / np.maximum(total, 1e-300), np.inf)


def _entry_weights(evidence: Evidence, residuals: Array, scales: Array) -> Array:
    """(W, L, K) Student's weights of whitened residuals, over their variance."""
    nu, s = evidence.density.degrees_of_freedom, evidence.entry_scales(scales)
    weight = (nu + 1) / (nu + (residuals / s) ** 2) / s**2
    return np.where(evidence.windows.inside[..., None], weight, 0.0)


def _bounded_leverage(information: Array, settings: EffectFitSettings) -> Array:
    """(W,) weights of windows, given each parameter's information in each (W, P)."""
    share = np.ones(len(information))
    for column in information.T:
        acts = column > 1e-6 * column.max(initial=0.0)
        if acts.sum() >= settings.leverage_windows:
            most = settings.leverage * np.quantile(column[acts], 0.9)
            share = np.minimum(share, most / np.maximum(column, most))
    return share


def fit(
    evidence: Evidence,
    start: Hypothesis,
    *,
    n_tosses: int,
    iterations: int | None = None,
    held: frozenset[str] = frozenset(),
) -> Fitted:
    """A hypothesis with fitted parameters, and the windows' first states with them.

    Args:
        evidence: At first states of a hypothesis near by.
        start: Values to begin with.
        n_tosses: How many tosses there are.
        iterations: Most iterations; the settings' if None.
        held: Names of effects whose values stay as they are.
    """
    settings = evidence.windows.settings.fit
    hypothesis, steps = start, start.steps
    free = [j for j, owner in enumerate(start.parameter_owners) if owner not in held]
    evidence = evidence.relinearised(start.world())
    residuals = evidence.residuals(start.world())
    scales = evidence.scales(residuals)
    damping, moved, sizes = 1e-3, True, np.full(len(steps), settings.widest_difference)
    taken: Derivatives | None = None
    most = settings.iterations if iterations is None else iterations
    for _ in range(most if free else 0):
        if moved:
            taken = _taken(taken, evidence, hypothesis, residuals, free, sizes)
            H, g = toss_sums(evidence, residuals, taken.values, scales, n_tosses)
            sizes = _difference_sizes(H, settings)
        before = evidence.log_likelihood(residuals, scales)
        step = _step(evidence, hypothesis, (H.sum(0), g.sum(0)), scales, before, damping)
        if step is None:
            break
        trial, gain, damping = step
        there = evidence.relinearised(trial.world())
        renewed = there.residuals(trial.world())
        # half of the gain at the first states of before, half at those that suit the step
        same_states = there.log_likelihood_of(hypothesis.world(), scales)
        gain = 0.5 * (gain + there.weighted_gain(there.log_likelihood(renewed, scales), same_states))
        if gain <= 0:
            # better at the first states of before only
            damping, moved = max(damping, 1e-2) * 30, False
            continue
        information = np.sqrt(np.maximum(np.diag(H.sum(0)), 0.0))
        change = np.abs(trial.flat() - hypothesis.flat()) / steps * information
        hypothesis, evidence, residuals, moved = trial, there, renewed, True
        scales = np.minimum(scales, evidence.scales(residuals))
        damping = SCHEDULE.accepted(damping)
        if gain < settings.least_gain or change.max() < settings.converged:
            break
    taken = _taken(taken, evidence, hypothesis, residuals, free, sizes)
    H, g = toss_sums(evidence, residuals, taken.values, scales, n_tosses)
    return Fitted(hypothesis, evidence, residuals, evidence.scales(residuals), H, g)


def _taken(
    before: Derivatives | None,
    evidence: Evidence,
    hypothesis: Hypothesis,
    residuals: Array,
    which: Sequence[int],
    sizes: Array,
) -> Derivatives:
    """Derivatives at a hypothesis, those of before where they still hold."""
    if before is not None:
        return before.renewed(evidence, hypothesis, residuals, which, sizes)
    values = derivatives(evidence, hypothesis, residuals, which, sizes)
    return Derivatives(values, evidence.predicted(hypothesis.world()), sizes)


def _step(
    evidence: Evidence,
    hypothesis: Hypothesis,
    sums: tuple[Array, Array],
    scales: Array,
    before: Array,
    damping: float,
) -> tuple[Hypothesis, float, float] | None:
    """A damped Gauss-Newton step that gains at the present first states, doubled while it gains more.

    Returns:
        The hypothesis there, its gain, and the damping that was needed; None if no damping gains.
    """
    settings = evidence.windows.settings.fit
    (H, g), steps = sums, hypothesis.steps

    def gained(to: Hypothesis) -> float:
        return evidence.weighted_gain(evidence.log_likelihood_of(to.world(), scales), before)

    def attempt(damping: float) -> tuple[Hypothesis, float] | None:
        delta = damped_step(H, g, damping, np.diag(H), ridge=1e-9 * max(np.trace(H), 1e-12))
        moved = hypothesis.clipped(hypothesis.flat() + np.clip(delta, -100, 100) * steps)
        gain = gained(moved)
        return (moved, gain) if gain > 0 else None

    found, damping = search_damping(attempt, damping, SCHEDULE, trials=settings.dampings)
    if found is None:
        return None
    moved, gain = found
    for _ in range(settings.doublings):
        # first states that have not followed yet hold a step back
        further = hypothesis.clipped(2 * moved.flat() - hypothesis.flat())
        beyond = gained(further)
        if not beyond > gain:
            break
        moved, gain = further, beyond
    return moved, gain, damping


def perturbed(fitted: Fitted) -> tuple[Evidence, Hypothesis]:
    """A fitted hypothesis moved on along the directions that its likelihood determines least, and the evidence there.

    It is moved by one standard error, and by ever more while that is better with first states that have followed. Steps
    of a fit are judged at first states that suit what they start from; there contact may hold a parameter where no
    likelihood does.

    Args:
        fitted: The hypothesis.
    """
    evidence, hypothesis, scales = fitted.evidence, fitted.hypothesis, fitted.scales
    settings = evidence.windows.settings.fit
    size = np.sqrt(np.maximum(np.diagonal(fitted.H.sum(0)), 1e-12))
    information, directions = np.linalg.eigh(fitted.H.sum(0) / np.outer(size, size))
    now = evidence.log_likelihood_of(hypothesis.world(), scales)
    for i in range(min(len(size), settings.perturbed_directions)):
        # along an eigenvector of the correlations, a standard error long
        move = directions[:, i] / np.sqrt(max(information[i], 1e-9)) / size * hypothesis.steps
        for way in (move, -move):
            length = 1.0
            while length <= settings.largest_perturbation:
                moved = hypothesis.clipped(hypothesis.flat() + length * way)
                there = evidence.relinearised(moved.world(), refine=3)
                own = there.log_likelihood_of(moved.world(), scales)
                after = np.maximum(own, evidence.log_likelihood_of(moved.world(), scales))
                before = np.maximum(now, there.log_likelihood_of(hypothesis.world(), scales))
                if not there.weighted_gain(after, before) > settings.least_gain:
                    break
                hypothesis, evidence, now, length = moved, there, own, 2 * length
    return evidence, hypothesis


def _difference_sizes(H: Array, settings: EffectFitSettings) -> Array:
    """(P,) of central differences, in steps: two standard errors either way, over which curvature shall hold."""
    sizes = 4.0 / np.sqrt(np.maximum(np.diagonal(H.sum(0)), 1e-12))
    return np.clip(sizes, settings.narrowest_difference, settings.widest_difference)
