"""Simulation-based calibration: where true values lie within what a diagnosis states of them.

A stated interval is taken as a distribution: Student's, with the value as its middle and the interval's ends as its
2.5 and 97.5 % points. If intervals are right, the true value's rank (the probability below it) is uniform over cases
whose truth is drawn; Talts et al., "Validating Bayesian inference algorithms with simulation-based calibration",
arXiv:1804.06788 (2018).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import kstest
from scipy.stats import t as student


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
    """For each rank, whether the true value lies within the interval of another coverage, symmetric in probability.

    Args:
        ranks: Of true values.
        level: Coverage of the interval.
    """
    return [abs(2 * each - 1) <= level for each in ranks]


def uniform_p(cases: Sequence[Sequence[float]]) -> float | None:
    """The probability of ranks as uneven as these (Kolmogorov and Smirnov); None of none.

    Args:
        cases: Ranks of the parameters of each case. They are dependent, so one of each case is drawn.
    """
    rng = np.random.default_rng(0)
    single = [float(rng.choice(ranks)) for ranks in cases if ranks]
    return float(kstest(single, "uniform").pvalue) if single else None
