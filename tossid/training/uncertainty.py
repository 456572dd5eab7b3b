"""Intervals of what rollouts determine, over tosses, and what the tosses do not determine.

The toss is the unit: its frames share one first state. Gauss-Newton's sums of each toss at the end of training, H_i and
g_i with sums H and g, say how far the parameters would be elsewhere without toss i, without training again:

    d_i = -(H - H_i)^-1 (g - g_i).

With d their mean, (n - 1) / n sum_i (d_i - d)(d_i - d)^T is the jackknife's covariance, which is the sandwich corrected
for each toss's leverage (MacKinnon, Nielsen and Webb, "Fast and reliable jackknife and bootstrap methods for
cluster-robust inference", J. Appl. Econometrics 2023). Of ten tosses and as many parameters it has too low a rank. So
its scale alone is taken from it, pooled over the P directions, and the directions from H:

    V = s² H^-1,   s² = (n - 1) / (n P) sum_i (d_i - d)^T H (d_i - d).

Two terms are added. Training ends beside the minimum, by a step h = -H^-1 g: h h^T. And rollouts follow Coulomb's law,
where MuJoCo, and perhaps the thing, follow its convex relaxation, in which what slips is lifted (Anitescu 2006). By
that law the minimum is a step a elsewhere: a a^T, unless the tosses reject it, by their paired losses. Where inertia is
learned, friction, inertia and spring make up for the law together, over a longer way than a step. Then the tosses
determine the centre of mass alone.

An interval is value -+ t sigma, or value exp(-+ t sigma / value) of what is positive, with Student's t of n - 1 degrees
of freedom. Corners are taken as they are. So is k_res, for which V counts 1.5 times. `docs/results/coverage.md` has
how many intervals hold the truth.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from tossid.errors import ObjectError
from tossid.models.parameters import ContactLaw
from tossid.models.protocol import Objective
from tossid.objects import ObjectModel
from tossid.training.fit import Fit
from tossid.training.prediction import GaussNewton, PredictionError

Array = NDArray[np.float64]

METHOD = "jackknife over tosses with pooled scale, Student's t"
REJECTED = 0.05
"""Level of Student's paired test at which tosses reject the relaxation."""
AFTER_FLIGHT = 1.5
"""Variance where flight has taught a k_res before, over that of rollouts alone: with the same 4 to 10 tosses, errors of
friction are 1.7 times those of models without it, and V of rollouts is 1.3² times theirs."""
STEP = 1e-3
"""Of the differences of what parameters mean, in the parameters' own units of order one."""
WEAK_FRICTION, WEAK_COM, WEAK_CONTACT_REL, WEAK_INERTIA_REL = 0.05, 5e-3, 0.5, 0.25
"""Half widths of intervals beyond which the tosses do not determine friction, a centre of mass [m], and, relative to
the value, a number of the contact law and an inertia or mass: such an interval confines nothing that one would use."""
TOTAL_MASS = "total mass: tosses over a fixed ground show ratios of masses only"
OPEN, OPEN_LAW = "the tosses leave it open", "the tosses do not tell Coulomb's law from its relaxation (MuJoCo's)"
"""Why there is no interval."""


def parameter_intervals(fit: Fit) -> dict[str, Any] | None:
    """95 % intervals of what the rollout stage learned, and the quantities that these tosses do not determine.

    Args:
        fit: At its end.

    Returns:
        {"method", "n_tosses", "intervals": {name: {"value", "ci95"}}, "not_determined": text} in SI units, names such
        as "com_z_m" (with the body's name where there are several). "ci95" is None of what the tosses do not determine,
        beside a "reason"; the text, one line, has these names. None if there was no rollout stage.
    """
    prediction = fit.longest_prediction()
    if prediction is None:
        return None
    sums = prediction.gauss_newton()
    n, none = len(sums.g), {"method": METHOD, "n_tosses": len(sums.g), "intervals": {}}
    if n < 2:
        return {**none, "not_determined": "all that was learned: one toss has no scatter"}
    if not sums.H.any():
        return {**none, "not_determined": "all that was learned: no rollout comes to the ground"}
    flight = any(plan.objective is Objective.FLIGHT_LOSS for plan in fit.stages)
    cov, law_is_sure = covariance(prediction, sums, widened=AFTER_FLIGHT if flight else 1.0)
    fitted = fit.model.learned_object()
    yields = fitted.compliance > 0
    values, slopes = quantities(fitted, yields=yields), _slopes(fit, prediction, sums.x, yields=yields)
    reach = student.ppf(0.975, n - 1) * np.sqrt(np.einsum("kp,pq,kq->k", slopes, cov, slopes))
    halves = {name: half for name, half in zip(values, reach.tolist(), strict=True) if half != 0.0}  # the rest is given
    compensates = not law_is_sure and any("inertia" in name for name in halves)
    intervals: dict[str, dict[str, Any]] = {}
    for name, half in halves.items():
        value = values[name]
        if not half <= _largest_half_width(name, value):
            intervals[name] = {"value": value, "ci95": None, "reason": OPEN}
        elif compensates and "com" not in name:
            intervals[name] = {"value": value, "ci95": None, "reason": OPEN_LAW}
        else:
            intervals[name] = {"value": value, "ci95": _ends(name, value, half)}
    return {**none, "intervals": intervals, "not_determined": _not_determined(intervals, n)}


def covariance(prediction: PredictionError, sums: GaussNewton, *, widened: float = 1.0) -> tuple[Array, bool]:
    """Covariance of the parameters (P, P), as the module says, and whether tosses reject the relaxation.

    Args:
        prediction: At the parameters of the sums, at which it stays.
        sums: Of two tosses or more.
        widened: Factor of V.
    """
    (n, size), H, g = sums.g.shape, sums.H.sum(0), sums.g.sum(0)
    ridge = 1e-6 * np.trace(H) / size * np.eye(size)
    # d_i = -(H - H_i)^-1 (g - g_i): where the minimum would be without toss i
    left_out = -np.linalg.solve(H - sums.H + ridge, (g - sums.g)[..., None])[..., 0]
    spread = left_out - left_out.mean(0)
    scale = (n - 1) / (n * size) * np.einsum("ip,pq,iq->", spread, H + ridge, spread)
    to_minimum = -np.linalg.solve(H + ridge, g)
    cov = widened * scale * np.linalg.inv(H + ridge) + np.outer(to_minimum, to_minimum)
    relaxed = prediction.with_relaxed_contact()
    if relaxed is None:
        return cov, False
    before, of_relaxed = prediction.training_losses(), relaxed.gauss_newton()
    to_relaxed = -np.linalg.solve(of_relaxed.H.sum(0) + ridge, of_relaxed.g.sum(0))
    prediction.set_parameters(sums.x + to_relaxed)
    with suppress(ObjectError):  # a step beyond every body
        # tosses reject the relaxation where their losses are higher with it, beyond their scatter
        gain = before - relaxed.training_losses()
        score = gain.mean() / max(gain.std(ddof=1) / np.sqrt(n), 1e-300)
        if student.cdf(score, n - 1) < REJECTED:
            to_relaxed *= 0.0
    prediction.set_parameters(sums.x)
    return cov + np.outer(to_relaxed, to_relaxed), not to_relaxed.any()


def _slopes(fit: Fit, prediction: PredictionError, x: Array, *, yields: bool) -> Array:
    """Derivatives (K, P) of what the parameters mean; NaN where there is no body to either side."""
    rows = []
    for j in range(len(x)):
        ends: list[tuple[float, Array]] = []
        for by in (-STEP, 0.0, STEP):
            moved = x.copy()
            moved[j] += by
            prediction.set_parameters(moved)
            with suppress(ObjectError):
                ends.append((by, np.array(list(quantities(fit.model.learned_object(), yields=yields).values()))))
        (first, low), (last, high) = ends[0], ends[-1]
        rows.append((high - low) / (last - first) if last > first else np.full_like(low, np.nan))
    prediction.set_parameters(x)
    return np.array(rows).T


def _ends(name: str, value: float, half: float) -> list[float]:
    """The interval's ends: of what is positive, by its logarithm."""
    if "com" in name:
        return [value - half, value + half]
    if "cohesion" in name:
        return [max(0.0, value - half), value + half]
    return [value * float(np.exp(-half / value)), value * float(np.exp(half / value))]


def _not_determined(intervals: dict[str, dict[str, Any]], n: int) -> str:
    """What is not determined, in one line."""
    names = [name for name, each in intervals.items() if each["ci95"] is None]
    if not names:
        return TOTAL_MASS
    which = "all that was learned" if len(names) == len(intervals) else ", ".join(names)
    law = [name for name in names if intervals[name]["reason"] == OPEN_LAW]
    also = f" ({OPEN_LAW})" if law == names else f" ({', '.join(law)}: {OPEN_LAW})" if law else ""
    return f"{which}, by {n} tosses{also}; {TOTAL_MASS}"


def _largest_half_width(name: str, value: float) -> float:
    """The half width of an interval beyond which the tosses do not determine a quantity."""
    if "friction" in name:
        return WEAK_FRICTION
    if "com" in name:
        return WEAK_COM
    in_contact = any(kind in name for kind in ("stiffness", "relaxation", "cohesion"))
    return (WEAK_CONTACT_REL if in_contact else WEAK_INERTIA_REL) * abs(value)


def quantities(model: ObjectModel, *, yields: bool) -> dict[str, float]:
    """What parameters mean, by name, in SI units.

    Args:
        model: The object with them.
        yields: Whether fitted contact does: rigid contact then counts as the stiffest spring.
    """
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
