"""The values that are reported: roots of the estimating equations, over where windows begin, at fine time steps.

A search simulates two steps a frame, and its fits end where no step gains. Contact makes a likelihood rough, so such a
place is only near the root of the estimating equations sum_i J_i^T W_i e_i = 0. The jackknife's covariance is that of
the root. So the found hypothesis is taken there by undamped scoring steps (Fisher scoring; J are differences two
standard errors wide either way, which average the roughness), with time steps a quarter as long.

What a window's uncertain first state takes up, and what a parameter does, depends on which frames are in one window
with an impact, alike in all tosses. No resampling of tosses shows that. So roots are found in windows that begin in
three places. Their mean is reported, and its variance joins that over tosses.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.inference.evidence import Evidence
from tossid.diagnosis.inference.fitting import Fit, fit
from tossid.diagnosis.inference.found import Found
from tossid.diagnosis.inference.sample import Sample

Array = NDArray[np.float64]

SHIFTS = (1 / 3, 2 / 3)
"""Of the length of a window."""
DEGREES = len(SHIFTS)
"""Degrees of freedom of the variance over these and the windows of the search."""
FINER = 4
"""Time steps of the final values over those of the search."""
STEPS = 4
"""Most scoring steps: roots are found to a tenth of a standard error in two to four."""
NEAR, FARTHEST = 0.1, 3.0
"""Standard errors at which a root is found, and that a step goes at most."""


@dataclass(frozen=True)
class FinalValues:
    """A found hypothesis at the values that are reported.

    Attributes:
        found: At these values.
        variance: (P,) of an effect's values beside that over tosses, by its name; of contact's effects.
    """

    found: Found
    variance: Mapping[str, Array]


def final_values(found: Found, shifted: Iterable[Sample]) -> FinalValues:
    """The final values of a found hypothesis.

    Args:
        found: By a search. What flight has determined has windows of its own, and keeps its values.
        shifted: The same tosses in windows that begin elsewhere.
    """
    h, fitted = found.hypothesis, found.fit
    contact = [name for name in h.names if name not in found.flown]
    if not contact:
        return FinalValues(found, {})
    placements = [fitted.evidence, *(sample.evidence(h) for sample in shifted)]
    roots = [root_of(fitted, each) for each in placements]
    values = np.array([root.hypothesis.flat() for root in roots])
    held, at_mean = found.flown, h.at(values.mean(0))
    mean = fit(roots[0].evidence, at_mean, n=fitted.n, iterations=0, held=held, sizes=roots[0].sizes)
    of_mean = values.var(0, ddof=1) / len(values)
    return FinalValues(replace(found, fit=mean), {name: of_mean[h.place_of(name)] for name in contact})


def root_of(fitted: Fit, evidence: Evidence) -> Fit:
    """The root of the estimating equations near a fit, by undamped scoring steps with first states that follow.

    Args:
        fitted: Where to begin, which parameters are free, and how wide differences are.
        evidence: Of the same hypothesis, in windows that may begin elsewhere.
    """
    held = frozenset(fitted.hypothesis.names) - {fitted.hypothesis.owners[j] for j in fitted.free}
    at = fit(
        with_finer_steps(evidence), evidence.hypothesis, n=fitted.n, iterations=0, held=held, sizes=fitted.widths()
    )
    for _ in range(STEPS):
        step = at.columns.step()
        size = float(np.abs(step / np.sqrt(np.diag(at.columns.covariance()))).max())
        if size < NEAR:
            break
        moved = at.moved(step * min(1.0, FARTHEST / size))
        at = fit(at.evidence, moved, n=at.n, iterations=0, held=held, follow=2, sizes=at.widths())
    return at


def with_finer_steps(evidence: Evidence) -> Evidence:
    """The evidence of the same hypothesis with shorter time steps, whose first states follow.

    Args:
        evidence: With the time steps of a search.
    """
    windows, h = evidence.windows, evidence.hypothesis
    coarse = windows.settings.simulation
    parts = max(coarse.compliant_impact_parts // FINER, coarse.impact_parts)
    simulation = replace(coarse, substeps=FINER * coarse.substeps, compliant_impact_parts=parts)
    finer = replace(windows, settings=replace(windows.settings, simulation=simulation))
    raw = finer.residuals(finer.predicted(h.world(), n_threads=evidence.n_threads))
    return replace(evidence, windows=finer, raw=raw).relinearised(h, steps=3)
