"""How far values in contact depend on where windows begin.

Contact makes a likelihood rough. What a window's uncertain first state takes up, and what a parameter does, depends on
which frames are in one window with an impact, alike in all tosses. No resampling of tosses shows that. So the found
hypothesis is fitted once more in windows that begin elsewhere, and the variance of its values joins that over tosses.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.inference.fitting import fit
from tossid.diagnosis.inference.found import Found
from tossid.diagnosis.inference.sample import Sample

Array = NDArray[np.float64]

SHIFTS = (1 / 3, 2 / 3)
"""Of the length of a window."""
DEGREES = len(SHIFTS)
"""Degrees of freedom of the variance over these and the windows of the search."""
ITERATIONS = 3
"""Most steps of a fit from the found values."""


def variance_over_shifts(found: Found, samples: Iterable[Sample]) -> dict[str, Array]:
    """(P,) variances of an effect's parameters over windows that begin elsewhere, by the effect's name.

    Args:
        found: By a search. What flight has determined has windows of its own, which are not shifted.
        samples: The same tosses in shifted windows.
    """
    h = found.hypothesis
    free = [name for name in h.names if name not in found.flown]
    if not free:
        return {}
    values = [h]
    for sample in samples:
        there = fit(sample.evidence(h), h, n=sample.n, iterations=ITERATIONS, held=found.flown)
        values.append(there.hypothesis)
    return {name: np.var([each.values_of(name) for each in values], axis=0, ddof=1) for name in free}
