"""How well the tosses know what rollouts taught: intervals by a bootstrap over tosses, and what they cannot see.

Gauss-Newton's sums of each toss at the minimum x, H_i and g_i, give every
resampled set of tosses its own minimum without training again,

    x_b = x - (sum_i c_i H_i)^-1 (sum_i c_i g_i - sum_i g_i),

with c_i how often toss i was drawn: the one-step bootstrap (Efron and Tibshirani,
"An Introduction to the Bootstrap", 1993, 22; the toss is the unit). What each x_b means (friction,
centre of mass, ..) is read off the model. The first states' noise is in the
intervals, as each toss has its own; a wrong physical assumption is not.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.objects import ObjectModel
from tossid.training.fit import Fit

Array = NDArray[np.float64]

RESAMPLES = 500
METHOD = "one-step bootstrap over tosses, percentiles"
WEAK = {
    "friction": 0.05,
    "com": 5e-3,
    "stiffness": 0.5,
    "relaxation": 0.5,
    "cohesion": 0.5,
    "inertia": 0.25,
    "mass": 0.25,
}
"""Half width of an interval beyond which a quantity counts as not seen: friction as it is, centres of mass in metres,
the others relative to their value."""


def parameter_intervals(fit: Fit, *, seed: int = 0) -> dict[str, Any] | None:
    """95 % intervals of what the rollout stage learned, and the quantities that these tosses do not see.

    Args:
        fit: at its end.
        seed: of the resampling.

    Returns:
        {"method", "n_tosses", "intervals": {name: {"value", "ci95"}}, "not_seen": [names]} in SI units, names such
        as "com_z_m" (with the body's name where there are several); None if there was no rollout stage, or only
        one toss.
    """
    stage = fit.longest_rollout()
    if stage is None:
        return None
    at = stage.sensitivity()
    n, size = at.g.shape
    if n < 2:
        return None
    rng = np.random.default_rng(seed)
    ridge = 1e-6 * np.trace(at.H.sum(0)) / size * np.eye(size)
    value = _readings(fit.model.learned_object())
    drawn = []
    for _ in range(RESAMPLES):
        counts = rng.multinomial(n, np.full(n, 1 / n))
        H, g = np.tensordot(counts, at.H, 1) + ridge, counts @ at.g - at.g.sum(0)
        stage.set_parameters(at.x - np.linalg.solve(H, g))
        drawn.append(list(_readings(fit.model.learned_object()).values()))
    stage.set_parameters(at.x)
    low, high = np.percentile(np.array(drawn), [2.5, 97.5], axis=0)
    intervals, unseen = {}, ["total mass: tosses over a fixed ground show ratios of masses only"]
    for i, (name, number) in enumerate(value.items()):
        half = 0.5 * (high[i] - low[i])
        if half == 0.0:
            continue  # given, not learned
        intervals[name] = {"value": number, "ci95": [float(low[i]), float(high[i])]}
        kind = next(kind for kind in WEAK if kind in name)
        if half > WEAK[kind] * (1.0 if kind in ("friction", "com") else abs(number)):
            unseen.append(f"{name}: known to ± {half:.2g} only")
    return {"method": METHOD, "n_tosses": n, "intervals": intervals, "not_seen": unseen}


def _readings(model: ObjectModel) -> dict[str, float]:
    """What the parameters mean, by name."""
    values = {"friction": model.friction}
    if model.compliance > 0:
        values |= {"stiffness_npm": 1 / model.compliance, "relaxation_s": model.relaxation}
        values["cohesion_n"] = model.cohesion
    for b, body in enumerate(model.body_names):
        prefix = "" if model.n_bodies == 1 else f"{body}_"
        for i, axis in enumerate("xyz"):
            values[f"{prefix}com_{axis}_m"] = float(model.com[b, i])
        for i, axis in enumerate("xyz"):
            values[f"{prefix}inertia_{axis}{axis}_kgm2"] = float(model.inertia[b, i, i])
        if b:
            values[f"{prefix}mass_kg"] = float(model.mass[b])
    return values
