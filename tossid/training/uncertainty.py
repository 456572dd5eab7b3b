"""Intervals of what rollouts determine, by a bootstrap over tosses, and what the tosses do not determine.

Gauss-Newton's sums of each toss at the minimum x, H_i and g_i, give every resampled set of tosses its own minimum
without training again,

    x_b = x - (sum_i c_i H_i)^-1 (sum_i c_i g_i - sum_i g_i),

with c_i how often toss i was drawn: the one-step bootstrap (Efron and Tibshirani, "An Introduction to the Bootstrap",
1993; the toss is the unit). What each x_b means (friction, centre of mass, ...) is read off the model. The noise of
first states is in the intervals, as each toss has its own; a wrong physical assumption is not.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.errors import ObjectError
from tossid.models.parameters import ContactLaw
from tossid.objects import ObjectModel
from tossid.settings.training import IntervalSettings
from tossid.training.fit import Fit

Array = NDArray[np.float64]

METHOD = "one-step bootstrap over tosses, percentiles"


def parameter_intervals(fit: Fit, *, seed: int = 0) -> dict[str, Any] | None:
    """95 % intervals of what the rollout stage learned, and the quantities that these tosses do not determine.

    Args:
        fit: At its end.
        seed: Of the resampling.

    Returns:
        {"method", "n_tosses", "intervals": {name: {"value", "ci95"}}, "not_seen": [text]} in SI units, names such
        as "com_z_m" (with the body's name where there are several); None if there was no rollout stage, only
        one toss, or rollouts that depend on no parameter.
    """
    stage = fit.longest_rollout()
    if stage is None:
        return None
    sums = stage.gauss_newton(central=stage.central)
    n, size = sums.g.shape
    if n < 2 or not sums.H.any():  # rollouts that never land depend on nothing that is learned
        return None
    rng, settings = np.random.default_rng(seed), fit.settings.intervals
    ridge = 1e-6 * np.trace(sums.H.sum(0)) / size * np.eye(size)
    fitted = fit.model.learned_object()
    yields = fitted.compliance > 0
    value, drawn = _readings(fitted, yields=yields), []
    counts = rng.multinomial(n, np.full(n, 1 / n), size=settings.draws)
    H, g = np.tensordot(counts, sums.H, 1) + ridge, counts @ sums.g - sums.g.sum(0)
    for step in np.linalg.solve(H, g[..., None])[..., 0]:
        stage.set_parameters(sums.x - step)
        with suppress(ObjectError):  # these tosses alone would lead beyond every body
            drawn.append(list(_readings(fit.model.learned_object(), yields=yields).values()))
    stage.set_parameters(sums.x)
    intervals, weak = {}, ["total mass: tosses over a fixed ground show ratios of masses only"]
    if len(drawn) < settings.draws:
        weak.append(f"{settings.draws - len(drawn)} of {settings.draws} resampled sets of tosses lead to no body")
    low, high = np.percentile(drawn or [list(value.values())], [2.5, 97.5], axis=0)
    for i, (name, number) in enumerate(value.items()):
        half = 0.5 * (high[i] - low[i])
        if half == 0.0:
            continue  # given, not learned
        intervals[name] = {"value": number, "ci95": [float(low[i]), float(high[i])]}
        if half > _limit(name, number, settings):
            weak.append(f"{name}: known to ± {half:.2g} only")
    return {"method": METHOD, "n_tosses": n, "intervals": intervals, "not_seen": weak}


def _limit(name: str, value: float, settings: IntervalSettings) -> float:
    """The half width of an interval beyond which the tosses do not determine a quantity."""
    limits = {
        "friction": settings.weak_friction,
        "com": settings.weak_com,
        "stiffness": settings.weak_contact_rel * abs(value),
        "relaxation": settings.weak_contact_rel * abs(value),
        "cohesion": settings.weak_contact_rel * abs(value),
        "inertia": settings.weak_inertia_rel * abs(value),
        "mass": settings.weak_inertia_rel * abs(value),
    }
    return next(limit for kind, limit in limits.items() if kind in name)


def _readings(model: ObjectModel, *, yields: bool) -> dict[str, float]:
    """What the parameters mean, by name. Where fitted contact yields, rigid contact counts as the stiffest spring."""
    values = {"friction": model.friction, "cohesion_n": model.cohesion}
    if yields:
        stiffest = float(model.mass.sum()) / (1e-3 * ContactLaw.RIGID_UP_TO) ** 2
        values |= {"stiffness_npm": 1 / max(model.compliance, 1 / stiffest), "relaxation_s": model.relaxation}
    for b, body in enumerate(model.body_names):
        prefix = "" if model.n_bodies == 1 else f"{body}_"
        for i, axis in enumerate("xyz"):
            values[f"{prefix}com_{axis}_m"] = float(model.com[b, i])
        for i, axis in enumerate("xyz"):
            values[f"{prefix}inertia_{axis}{axis}_kgm2"] = float(model.inertia[b, i, i])
        if b:
            values[f"{prefix}mass_kg"] = float(model.mass[b])
    return values
