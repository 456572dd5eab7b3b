"""Simulation-based calibration: where true values lie within what a diagnosis states of them.

A stated interval is taken as a distribution: Student's, with the value as its middle and the interval's ends as its
2.5 and 97.5 % points. If intervals are right, the true value's rank (the probability below it) is uniform over cases
whose truth is drawn; Talts et al., "Validating Bayesian inference algorithms with simulation-based calibration",
arXiv:1804.06788 (2018). The parameters of an effect are judged together by the coverage of random balls: around a point
that knows nothing of the truth, the probability of what is nearer than the truth is uniform too; Lemos et al.,
"Sampling-based accuracy testing of posterior estimators for general inference", ICML (2023).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import kstest, kstwo, ncx2, norm
from scipy.stats import t as student

LEVELS = (0.5, 0.9)
"""Coverages that are counted beside that of the stated 95 % intervals."""

_FAR = 6.0
"""Standard normal number beyond which a rank cannot be distinguished from 0 or 1."""
_SPREAD = 2.0
"""Standard deviation of the balls' centres, in standard deviations of what is stated."""


def rank(true: float, stated: Mapping[str, Any], freedom: float) -> float | None:
    """The probability that a stated interval gives to values below the true one.

    Ends that were drawn in to what is physically possible are taken to be as far away as the other end.

    Args:
        true: The true value.
        stated: `value` and `ci95`, as a parameter of gap.json.
        freedom: Degrees of freedom: tosses without parameters.

    Returns:
        The rank; None if no interval is stated, or one without width.
    """
    value, (low, high) = stated["value"], stated["ci95"]
    if any(x is None for x in (value, low, high)) or high <= low:
        return None
    error = max(high - value, value - low) / student.ppf(0.975, freedom)
    return float(student.cdf((true - value) / error, freedom))


def within(ranks: Sequence[float], level: float) -> list[bool]:
    """Whether true values lie within the intervals of another coverage.

    Args:
        ranks: Ranks of true values.
        level: Coverage of the interval, symmetric in probability.

    Returns:
        For each, whether it does.
    """
    return [abs(2 * each - 1) <= level for each in ranks]


def joint_rank(ranks: Sequence[float], correlation: Sequence[Sequence[float]], rng: np.random.Generator) -> float:
    """The stated probability of a ball around a random point, which has the truth on its surface.

    Args:
        ranks: (P,) ranks of an effect's parameters.
        correlation: (P, P) stated correlation of their errors.
        rng: Draws the ball's centre.

    Returns:
        The probability, uniform if what is stated is right.
    """
    truth = np.clip(norm.ppf(np.asarray(ranks)), -_FAR, _FAR)
    weights, axes = np.linalg.eigh(np.asarray(correlation))
    truth = axes.T @ truth / np.sqrt(np.maximum(weights, 1e-6))
    centre = _SPREAD * rng.standard_normal(len(truth))
    return float(ncx2.cdf(((truth - centre) ** 2).sum(), len(truth), (centre**2).sum()))


def band(n: int) -> float:
    """Half width of the 95 % band of the whole cumulative distribution of `n` uniform numbers (Kolmogorov).

    Args:
        n: How many independent numbers.

    Returns:
        The half width.
    """
    return float(kstwo.ppf(0.95, n))


def ranks_of(parameters: Sequence[Mapping[str, Any]], led: bool | None = None) -> NDArray[np.float64]:
    """The ranks of a case's or an audit's parameters.

    Args:
        parameters: As `score` returns them.
        led: Only of effects that lead their class, or only of those that do not; None: of all.

    Returns:
        (n,) those that are known.
    """
    chosen = (p["rank"] for p in parameters if led is None or p["led"] == led)
    return np.array([each for each in chosen if each is not None])


def summarise_ranks(scores: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """The measures of calibration over scored cases.

    Args:
        scores: What `score` returned for each case.

    Returns:
        By measure, the `count` `of` how many and its `share`, or a `value`: coverages of other levels; coverage of
        95 % where the true effect leads its class, and where it stands behind another name; and the probability of
        ranks as uneven as these, each case counted by one drawn parameter, and by all of them together.
    """
    parameters = [p for s in scores for p in s["parameters"]]
    out: dict[str, dict[str, Any]] = {}
    for level in LEVELS:
        out[f"coverage_{100 * level:.0f}"] = share_of(within(ranks_of(parameters).tolist(), level), level)
    for name, led in (("coverage_led", True), ("coverage_behind", False)):
        out[name] = share_of([p["covered"] for p in parameters if p["led"] == led], 0.95)
    rng = np.random.default_rng(0)
    single = [float(rng.choice(each)) for s in scores if len(each := ranks_of(s["parameters"]))]
    joint = [each for s in scores for each in s["joint_ranks"]]
    for name, ranks in (("ranks_uniform", single), ("joint_ranks_uniform", joint)):
        out[name] = {"value": float(kstest(ranks, "uniform").pvalue) if ranks else None, "of": len(ranks)}
    return out


def share_of(values: Sequence[bool], wanted: float | None) -> dict[str, Any]:
    """A measure that counts.

    Args:
        values: Of each case or parameter, whether it is so.
        wanted: The share that is wanted, if any.

    Returns:
        The `count` `of` how many, the `share` (None of none) and what is `wanted`.
    """
    n = len(values)
    return {"count": int(sum(values)), "of": n, "share": sum(values) / n if n else None, "wanted": wanted}
