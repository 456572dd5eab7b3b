"""Which effect changes over the order of recording, where, and by how much.

Each toss says by itself what an effect's parameters are (`values`). Where these change over the order is found and
tested as changes of a recording are (`tossid.motion.sessions.change_points`): by permutation, for all effects together.
What an effect does over the order is then one of two things: it takes a step at each change, or it drifts, a line over
the number of the toss. With the scores g_i of its mean and a design X of the order, n tosses,

    T = sum over i of (P_X g)_i^T V⁺ (P_X g)_i,     V = sum of g_i g_i^T / n,

is the score statistic of either (P_X projects on the centred columns of X); each further number costs log n.

Many effects seem to change where one does. The candidates are fitted, stretch by stretch, and compared by likelihood.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.likelihood.fitting import Fitted, fit
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.sessions.correction import CORRECTABLE
from tossid.motion.sessions.change_points import Change, Witness, find_changes, robust_mean, without_covariates
from tossid.physics.effects import Effect
from tossid.settings.diagnosis.order import OrderSettings

Array = NDArray[np.float64]
Form = Literal["steps", "drift"]


@dataclass(frozen=True, eq=False)
class EffectOverOrder:
    """An effect that is not the same in all tosses.

    Attributes:
        effect: The effect.
        form: How it goes over the order.
        edges: First tosses of the stretches in which it was fitted, and the number of tosses, (k + 1,). Of steps these
            are the sessions.
        values: (n, P) its parameters in each toss.
        p_value: Probability of such a change in an order that means nothing, corrected for all that was looked at.
        parameters: Over all tosses, the mean of each parameter.
        stretches: Of each stretch, the parameters.
        rate: Of a drift, the change of each parameter from toss to toss; empty of steps.
        fitted: The fits of the stretches.
    """

    effect: Effect
    form: Form
    edges: tuple[int, ...]
    values: Array
    p_value: float
    parameters: dict[str, Interval]
    stretches: tuple[dict[str, Interval], ...]
    rate: dict[str, Interval]
    fitted: tuple[Fitted, ...]

    @property
    def correctable(self) -> bool:
        """Whether it is an error of the recording that can be undone toss by toss."""
        return self.effect.name in CORRECTABLE


def changes_over_order(witnesses: Mapping[str, Witness], settings: OrderSettings) -> tuple[Change, ...]:
    """Where anything changes over the order.

    Args:
        witnesses: Of `witnesses_of`.
        settings: Significance and the smallest session.
    """
    return find_changes(witnesses, settings=settings.changes)


def effect_over_order(
    present: Candidate,
    validator: CrossValidator,
    library: Sequence[Effect],
    witnesses: Mapping[str, Witness],
    changes: Sequence[Change],
    settings: OrderSettings,
    *,
    boundaries: Sequence[int] = (),
) -> EffectOverOrder | None:
    """The effect whose change over the order explains most; None if no effect changes.

    Args:
        present: The hypothesis beside which it changes.
        validator: Of all windows.
        library: The effects among which it is.
        witnesses: Of `witnesses_of`.
        changes: Of `changes_over_order`.
        settings: How candidates are compared.
        boundaries: Numbers of tosses with which sessions of the dataset begin.
    """
    p = {name: min(c.p[name] for c in changes if name in c.p) for c in changes for name in c.p}
    by_name, outlier = {effect.name: effect for effect in library}, settings.changes.outlier
    judged = []
    for name in p:
        if name in by_name:
            at = tuple(change.at for change in changes if name in change.p)
            at = moments_of_steps(witnesses[name], at, settings)
            form, criterion = form_over_order(witnesses[name], at, outlier=outlier)
            at = _at_sessions(at, boundaries, settings.same_change)
            judged.append((criterion, name, _edges(validator.n, at, form, settings), form))
    if not judged:
        return None
    most = max(each[0] for each in judged)
    judged = sorted((each for each in judged if each[0] > settings.likely * most), reverse=True, key=lambda x: x[0])
    before = present.evidence.log_likelihood(present.fitted.residuals, present.fitted.scales)

    def tried(each: tuple[float, str, tuple[int, ...], Form]) -> tuple[float, EffectOverOrder]:
        _, name, edges, form = each
        fits = fitted_stretches(present, by_name[name], edges, validator, near=witnesses[name], outlier=outlier)
        after = np.zeros(len(before))
        for k, one in enumerate(fits):
            after[_rows(present, edges, k)] = one.evidence.log_likelihood(one.residuals, present.fitted.scales)
        gain = present.evidence.weighted_gain(after, before)
        parameters = len(fits) * len(by_name[name].parameters)
        return gain - 0.5 * parameters * np.log(validator.n), described(by_name[name], form, edges, fits, p[name])

    found = validator.map(tried, judged[: settings.candidates])
    best = max(gain for gain, _ in found)
    # the object and gravity stay the same
    changeable = [each for each in found if each[1].effect.family != "body" and each[1].effect.name != "gravity"]
    if changeable and max(gain for gain, _ in changeable) > settings.unchanging * best:
        found = changeable
        best = max(gain for gain, _ in found)
    close = [each for each in found if each[0] > best - settings.indistinguishable * abs(best)]
    # of what fits alike, a recording that changes is the simpler story, and so is a special case
    recording = [each for each in close if each[1].effect.family == "measurement" or each[1].correctable]
    names = {each[1].effect.name for each in close}
    special = [each for each in close if not names & set(each[1].effect.contains)]
    return max(recording or special or close, key=lambda each: each[0])[1]


def form_over_order(witness: Witness, at: Sequence[int], *, outlier: float) -> tuple[Form, float]:
    """Whether values step at some changes or drift, and the score statistic of that less what its numbers cost.

    Args:
        witness: Values (n, P), information (n, P, P) and covariates of tosses in their order.
        at: First tosses after the changes.
        outlier: As of `robust_mean`.
    """
    recorded, info, covariates = witness
    scores = robust_mean(without_covariates(recorded, info, covariates, outlier=outlier), info, outlier=outlier).scores
    n, d = scores.shape
    scores = scores - scores.mean(axis=0)
    inverse = np.linalg.pinv(scores.T @ scores / n, rcond=1e-10, hermitian=True)
    order = np.arange(n)
    steps = (order[:, None] >= np.asarray(at)).astype(float)
    designs: dict[Form, Array] = {"steps": steps, "drift": order[:, None].astype(float)}
    cost = {"steps": len(at) * (d + 1), "drift": d}
    criterion: dict[Form, float] = {}
    for form, X in designs.items():
        projected = X - X.mean(axis=0)
        projected = projected @ np.linalg.lstsq(projected, scores, rcond=None)[0]
        criterion[form] = float(np.einsum("ni,ij,nj->", projected, inverse, projected)) - cost[form] * np.log(n)
    best: Form = "steps" if criterion["steps"] >= criterion["drift"] else "drift"
    return best, criterion[best]


def moments_of_steps(witness: Witness, at: Sequence[int], settings: OrderSettings) -> tuple[int, ...]:
    """The likeliest first tosses of steps near where they were found.

    The score statistic compares both sides of a step with one mean. Here each toss has the mean of the side that it
    would be on.

    Args:
        witness: Values, information and covariates of tosses in their order.
        at: First tosses after the changes.
        settings: How far a moment may move.
    """
    recorded, info, covariates = witness
    outlier, n = settings.changes.outlier, len(recorded)
    values = without_covariates(recorded, info, covariates, outlier=outlier)
    edges = [0, *at, n]
    for k in range(1, len(edges) - 1):
        low, now, high = edges[k - 1 : k + 2]
        sides = [robust_mean(values[part], info[part], outlier=outlier) for part in (slice(low, now), slice(now, high))]
        if not all(side.n for side in sides):
            continue
        W = info @ np.linalg.inv(np.eye(values.shape[1]) + max(side.scatter for side in sides) ** 2 * info)
        cost = []
        for side in sides:
            off = np.where(np.trace(info, axis1=1, axis2=2)[:, None] > 0, values - side.value, 0.0)
            size = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", off, W, off), 0.0))
            cost.append(np.where(size < outlier, 0.5 * size**2, outlier * (size - 0.5 * outlier)))
        saved = np.cumsum(cost[0] - cost[1])
        near = np.arange(max(low + 1, now - settings.largest_move), min(high - 1, now + settings.largest_move) + 1)
        edges[k] = int(near[np.argmin(saved[near - 1])])
    return tuple(edges[1:-1])


def _at_sessions(at: Sequence[int], boundaries: Sequence[int], near: int) -> tuple[int, ...]:
    """Steps where the dataset has sessions, if it has them nearby; no two at one toss."""
    moved = {
        min((b for b in boundaries if abs(b - each) <= near), key=lambda b: abs(b - each), default=each) for each in at
    }
    return tuple(sorted(moved - {0}))


def _edges(n: int, at: Sequence[int], form: Form, settings: OrderSettings) -> tuple[int, ...]:
    """First tosses of stretches, and n: the sessions of steps, or equal parts of a drift."""
    if form == "steps":
        return (0, *at, n)
    parts = max(2, min(settings.drift_parts, n // settings.changes.fewest_tosses))
    return tuple(round(n * k / parts) for k in range(parts + 1))


def _rows(present: Candidate, edges: Sequence[int], k: int) -> NDArray[np.int64]:
    """Numbers of the windows of a stretch's tosses."""
    toss = present.evidence.windows.toss
    return np.flatnonzero((toss >= edges[k]) & (toss < edges[k + 1]))


def fitted_stretches(
    present: Candidate,
    effect: Effect,
    edges: Sequence[int],
    validator: CrossValidator,
    *,
    near: Witness | None = None,
    outlier: float = 3.0,
) -> tuple[Fitted, ...]:
    """An effect beside a hypothesis, fitted to each stretch of tosses; the hypothesis's other effects stay.

    Args:
        present: The hypothesis.
        effect: The effect.
        edges: First tosses of the stretches, and n.
        validator: Of all windows.
        near: What each toss says of the effect, whose mean a fit starts from; None: what the hypothesis has.
        outlier: As of `robust_mean`.
    """
    hypothesis = present.hypothesis
    if effect.name not in hypothesis.names:
        hypothesis = hypothesis.plus(effect)
    place, held = hypothesis.place_of(effect.name), frozenset(hypothesis.names) - {effect.name}
    out = []
    for k in range(len(edges) - 1):
        start = hypothesis
        if near is not None:
            own = slice(edges[k], edges[k + 1])
            step = np.nan_to_num(robust_mean(near[0][own], near[1][own], outlier=outlier).value)
            flat = hypothesis.flat()
            flat[place] += step * hypothesis.steps[place]
            start = hypothesis.clipped(flat)
        evidence = present.evidence.rows(_rows(present, edges, k))
        scales = present.fitted.scales
        there, here = (evidence.log_likelihood_of(each.world(), scales) for each in (start, hypothesis))
        begin = start if evidence.weighted_gain(there, here) > 0 else hypothesis
        out.append(fit(evidence, begin, n_tosses=validator.n, held=held))
    return tuple(out)


def described(
    effect: Effect, form: Form, edges: tuple[int, ...], fits: tuple[Fitted, ...], p_value: float
) -> EffectOverOrder:
    """An effect over the order from the fits of its stretches.

    Args:
        effect: The effect.
        form: Steps or drift.
        edges: First tosses of the stretches, and n.
        fits: Of the stretches.
        p_value: Of the change.
    """
    n, sizes = edges[-1], np.diff(edges)
    values, variances = [], []
    for one in fits:
        place = one.hypothesis.place_of(effect.name)
        values.append(one.hypothesis.values_of(effect.name))
        variances.append(np.diag(one.covariance())[place])
    y, var, size = np.array(values), np.array(variances), len(effect.parameters)
    freedom = np.maximum(sizes - size, 1)
    names = [p.name for p in effect.parameters]

    def intervals(at: Array, of: Array, degrees: float) -> dict[str, Interval]:
        half = student_t.ppf(0.975, degrees) * np.sqrt(of)
        return {
            name: Interval(float(x), float(x - h), float(x + h)) for name, x, h in zip(names, at, half, strict=True)
        }

    share = (sizes / n)[:, None]
    whole = intervals((share * y).sum(0), (share**2 * var).sum(0), max(n - size, 1))
    stretches = tuple(intervals(y[k], var[k], float(freedom[k])) for k in range(len(fits)))
    if form == "steps":
        return EffectOverOrder(effect, form, edges, np.repeat(y, sizes, axis=0), p_value, whole, stretches, {}, fits)
    middle = 0.5 * (np.array(edges[:-1]) + np.array(edges[1:]) - 1)
    w = 1 / np.maximum(var, 1e-300)
    centre = (w * middle[:, None]).sum(0) / w.sum(0)
    spread = (w * (middle[:, None] - centre) ** 2).sum(0)
    level = (w * y).sum(0) / w.sum(0)
    slope = (w * (middle[:, None] - centre) * y).sum(0) / spread
    # stretches scatter about the line at least as their own errors say
    off = (w * (y - level - slope * (middle[:, None] - centre)) ** 2).sum(0) / max(len(fits) - 2, 1)
    rate = intervals(slope, np.maximum(off, 1.0) / spread, max(len(fits) - 2, 1))
    line = level + slope * (np.arange(n)[:, None] - centre)
    return EffectOverOrder(effect, form, edges, line, p_value, whole, stretches, rate, fits)
