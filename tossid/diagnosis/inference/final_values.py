"""Final values: the roots of the estimating equations, found over a range in which contact's roughness averages out.

A fit ends where no step gains. Contact makes a likelihood rough, so that place is only near the root of the estimating
equations sum_i J_i^T W_i e_i = 0, whose step d(theta) = -(sum H)^-1 sum g is zero. Two things keep a further step from
reaching it. First states follow parameters from one mode of an impact to another, which no derivative shows: where
theta is off by one, d is not one but a share a of it, often a quarter. And each mode that changes moves d by about a
standard error, as noise.

So d is computed from the full evidence at both ends of a range that is wide beside this noise, and

    a = -(d(theta + w) - d(theta - w)) / 2 w,    root = theta + (d(theta + w) + d(theta - w)) / 2 a.

With a, the derivatives J are a J: the jackknife's covariance of the root is larger by 1 / a^2.

What a window's uncertain first state takes up, and what a parameter does, depends on which frames are in one window
with an impact, alike in all tosses. No resampling of tosses shows that. So d is computed in windows that begin in
three places. The mean of the three roots is reported, and its variance joins that over tosses.
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
FINER, FINER_YIELDING = 4, 16
"""Time steps of the final values over those of the search, in rigid contact and where contact yields. There, four times
as many leave a damping 3 % low, which is some standard errors."""
APPROACH, FARTHEST = 2.0, 6.0
"""Multiple of d by which each place of the windows comes nearer to the root first, and standard errors at most."""
RANGE = 8.0
"""Half of the range, in standard errors, each parameter at either end by a random sign."""
LEAST_SHARE = 0.15
"""Of a parameter's change that d is at least: less is noise of a."""


@dataclass(frozen=True)
class FinalValues:
    """A found hypothesis at the values that are reported.

    Attributes:
        found: At these values.
        variance: (P,) of an effect's values beside that over tosses, by its name; of contact's effects.
    """

    found: Found
    variance: Mapping[str, Array]


def final_values(found: Found, samples: Iterable[Sample]) -> FinalValues:
    """The final values of a found hypothesis.

    Args:
        found: By a search. What flight has determined has windows of its own, and keeps its values.
        samples: The same tosses in windows that begin in different places.
    """
    h = found.hypothesis
    contact = [name for name in h.names if name not in found.flown]
    if not contact:
        return FinalValues(found, {})
    free, samples, sizes = list(found.fit.free), list(samples), found.fit.widths()

    def at(sample: Sample, flat: Array) -> Fit:
        """The estimating equations at some values, by the full evidence."""
        evidence = precise(sample.evidence(h.at(flat)))
        return fit(evidence, evidence.hypothesis, n=sample.n, iterations=0, held=found.flown, sizes=sizes)

    flat = h.flat()
    for sample in samples:
        there = at(sample, flat)
        step = APPROACH * there.columns.step()
        flat = there.moved(step * min(1.0, FARTHEST / np.abs(step / _errors(there)).max())).flat()
    rng, w, unit = np.random.default_rng(0), np.zeros(len(flat)), h.steps[free]
    values, steps = np.empty((2, len(samples), 2, len(free)))
    for k, sample in enumerate(samples):
        w[free] = rng.choice([-RANGE, RANGE], len(free)) * _errors(there) * unit
        ends = [at(sample, flat + w), at(sample, flat - w)]
        # (where a bound is in the way, the ends are nearer)
        values[k] = [end.hypothesis.flat()[free] / unit for end in ends]
        steps[k] = [end.columns.step() for end in ends]
    found_roots, share = roots_between(values, steps)
    roots = np.tile(flat, (len(samples), 1))
    roots[:, free] = found_roots * unit
    mean = at(samples[0], roots.mean(0))
    of_mean = roots.var(0, ddof=1) / len(roots)
    fitted = replace(mean, columns=mean.columns.scaled(share))
    return FinalValues(replace(found, fit=fitted), {name: of_mean[h.place_of(name)] for name in contact})


def roots_between(values: Array, steps: Array) -> tuple[Array, Array]:
    """Roots of steps that are linear in values, from both ends of ranges.

    Args:
        values: (k, 2, P) at the ends.
        steps: (k, 2, P) d there.

    Returns:
        (k, P) roots, and (P,) the mean share of its distance from a root that a step goes.
    """
    shares = -np.diff(steps, axis=1)[:, 0] / np.diff(values, axis=1)[:, 0]
    share = np.clip(shares.mean(0), LEAST_SHARE, 1.0)
    return values.mean(1) + steps.mean(1) / share, share


def _errors(at: Fit) -> Array:
    """(len(free),) standard errors by the jackknife, in declared steps."""
    return np.asarray(np.sqrt(np.diag(at.columns.covariance())))


def precise(evidence: Evidence) -> Evidence:
    """The evidence of the same hypothesis as shorter time steps make it, whose first states follow.

    Args:
        evidence: With the time steps of a search. Under a user's own engine, that one's steps count, and it stays.
    """
    windows, h = evidence.windows, evidence.hypothesis
    if h.law.engine.of_user:
        return evidence
    coarse = windows.settings.simulation
    steps = FINER_YIELDING if h.world().object.compliance > 0 else FINER
    simulation = replace(coarse, substeps=steps * coarse.substeps)
    finer = replace(windows, settings=replace(windows.settings, simulation=simulation))
    raw = finer.residuals(finer.predicted(h.world(), n_threads=evidence.n_threads))
    return replace(evidence, windows=finer, raw=raw).relinearised(h, steps=3)
