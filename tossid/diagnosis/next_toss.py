"""The next toss: the release that best separates the hypotheses which the tosses so far cannot distinguish.

For a release, the toss is predicted under the first hypothesis, noise-free but with the data's noise and slow errors
stated, and cut into windows as recorded ones are. The difference between two hypotheses there, whitened as in a fit
(first states and what engines disagree on are nuisance parameters), has the squared length that a diagnosis would find
on average beyond noise. Residuals count by Student's density, so that one chaotic impact does not decide.

The hypothesis that is wrong would be fitted again, and so take back a part of the difference. What is left after a
Gauss-Newton step of its own parameters counts, with the earlier tosses as what holds them (T-optimality; Atkinson and
Fedorov, "The design of experiments for discriminating between two rival models", Biometrika 62 (1975)). Either of two
hypotheses may be the right one, and the mean of both cases is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.inference.columns import slopes, sums
from tossid.diagnosis.inference.evidence import Evidence, collect
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.likelihood.density import student_deviance
from tossid.diagnosis.likelihood.states import difference
from tossid.diagnosis.likelihood.step_changes import State
from tossid.diagnosis.likelihood.windows import make_windows, steps_of
from tossid.motion import lowest_corner
from tossid.motion.resting import rest_scatter
from tossid.objects import ObjectModel
from tossid.rotations import quat_rotate
from tossid.types import Phase, Toss

Array = NDArray[np.float64]

CANDIDATES, EARLIER = 200, 20
"""Releases that are drawn, and earlier ones with which they are compared."""
WIDENED, CLEARANCE = 0.5, 0.02
"""Share by which the ranges of earlier releases are widened, and least height of the lowest corner [m]."""
MOST_RIVALS, MOST_FRAMES = 3, 100
"""Hypotheses that are compared, and frames of a toss that are predicted: later ones are at rest."""
LEAST_SEPARATION = 3.0
"""Expected separation below which no toss is proposed [standard deviations]."""


def next_toss(
    hypothesis: Hypothesis,
    alternatives: Sequence[Hypothesis],
    tosses: Sequence[Toss],
    sample: Sample,
    *,
    rng: np.random.Generator,
) -> dict[str, Any]:
    """gap.json's "next_toss"; {"release": None, "reason": ...} where nothing is confusable or nothing separates.

    Args:
        hypothesis: With the named effects.
        alternatives: With another effect of a confusable class in one's place.
        tosses: So far: their releases are feasible, and their covariances are the noise.
        sample: Their windows.
        rng: For the draw of releases.
    """
    if not alternatives:
        return {"release": None, "reason": "no two effects are confusable: no toss is needed to separate them"}
    stated = sample.windows.stated or hypothesis.base.object
    rivals = [hypothesis, *alternatives][:MOST_RIVALS]
    common = set.intersection(*(set(rival.names) for rival in rivals))
    names = [" + ".join(name for name in rival.names if name not in common) or "neither" for rival in rivals]
    candidates = draw_releases(tosses, stated, CANDIDATES, rng=rng)
    some = tosses[:: -(-len(tosses) // EARLIER)]
    earlier = State(np.stack([toss.q[0] for toss in some]), np.stack([toss.v[0] for toss in some]))
    frames = int(np.median([len(toss) for toss in tosses])) - 1

    expected = separations(rivals, candidates.and_rows(earlier), tosses, frames, sample)
    expected, usual = expected[:CANDIDATES], float(np.median(expected[CANDIDATES:]))
    best = int(np.argmax(expected))
    if not expected[best] > LEAST_SEPARATION:
        reason = (
            f"none of {CANDIDATES} feasible releases separates {' and '.join(names)} by more than "
            f"{max(float(expected[best]), 0.0):.1f} standard deviations"
        )
        return {"release": None, "reason": reason, "between": names}
    q, v = candidates.q[best], candidates.v[best]
    lowest = float(lowest_corner(stated, q[None])[0])
    return {
        "release": {
            "position_m": q[:3].tolist(),
            "attitude_wxyz": q[3:7].tolist(),
            "joints": q[7:].tolist(),
            "velocity_ms": v[:3].tolist(),
            "spin_body_rads": v[3:6].tolist(),
            "joint_rates": v[6:].tolist(),
            "lowest_corner_m": lowest,
            "horizontal_speed_ms": float(np.hypot(*v[:2])),
            "vertical_speed_ms": float(v[2]),
            "spin_rads": float(np.linalg.norm(v[3:6])),
        },
        "between": names,
        "separation_sd": float(expected[best]),
        "log_likelihood_ratio": float(expected[best] ** 2 / 2),
        "separation_of_tosses_seen_sd": usual,
        "candidates": CANDIDATES,
    }


def draw_releases(tosses: Sequence[Toss], stated: ObjectModel, n: int, *, rng: np.random.Generator) -> State:
    """Feasible releases: heights, speeds and spins from widened ranges of earlier ones; any attitude and heading.

    Args:
        tosses: Earlier ones.
        stated: Their object.
        n: How many.
        rng: For the draw.
    """

    def between(values: Array, least: float = -np.inf) -> Array:
        """(n,) uniform draws from the widened range of some values."""
        low, high = float(values.min()), float(values.max())
        room = 0.5 * WIDENED * (high - low)
        low, high = max(low - room, least), max(high + room, least)
        return rng.uniform(low, high, n)

    q0, v0 = np.stack([toss.q[0] for toss in tosses]), np.stack([toss.v[0] for toss in tosses])
    reach = float(np.linalg.norm(stated.drawn.corner_pos, axis=1).max())
    x, y = between(q0[:, 0]), between(q0[:, 1])
    low = between(lowest_corner(stated, q0), CLEARANCE)
    quat = rng.normal(size=(n, 4))
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    joints, rates = (
        np.stack([between(each) for each in values.T], axis=1) if values.shape[1] else np.zeros((n, 0))
        for values in (q0[:, 7:], v0[:, 6:])
    )
    q = np.concatenate([np.stack([x, y, np.full(n, reach)], axis=1), quat, joints], axis=1)
    q[:, 2] += low - lowest_corner(stated, q)
    heading = rng.uniform(0, 2 * np.pi, n)
    speed = between(np.hypot(v0[:, 0], v0[:, 1]), 0.0)
    axis = rng.normal(size=(n, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    spin = between(np.linalg.norm(v0[:, 3:6], axis=1), 0.0)
    climb = between(v0[:, 2])
    linear = np.stack([speed * np.cos(heading), speed * np.sin(heading), climb], axis=1)
    # the base's centre of mass has this velocity, whatever the spin
    linear -= quat_rotate(quat, np.cross(spin[:, None] * axis, stated.com[0]))
    return State(q, np.concatenate([linear, spin[:, None] * axis, rates], axis=1))


def separations(
    rivals: Sequence[Hypothesis], releases: State, tosses: Sequence[Toss], frames: int, sample: Sample
) -> Array:
    """(B,) expected separation of the two nearest rivals by one toss from each release [standard deviations].

    Args:
        rivals: The hypotheses.
        releases: B of them.
        tosses: Earlier ones, whose covariances are the noise.
        frames: Of a toss.
        sample: Windows of the earlier tosses, which hold the rivals' parameters.
    """
    w, threads, first = sample.windows, sample.n_threads, rivals[0].world()
    steps = np.full(len(releases.q), min(frames, MOST_FRAMES))
    how = steps_of(first, w.settings.simulation)
    run = first.roll_out(releases.q, releases.v, n_steps=steps, dt=w.dt, **how, n_threads=threads)
    good, out = np.flatnonzero(np.isfinite(run).all((1, 2))), np.zeros(len(releases.q))
    if not len(good):
        return out
    stated = w.stated or rivals[0].base.object
    cov = np.median(np.concatenate([toss.measured[1] for toss in tosses]), axis=0)
    predicted = [_as_toss(run[b], releases.v[b], w.dt, cov) for b in good]
    windows = make_windows(
        predicted, stated, settings=w.settings, flights=False, scatter=rest_scatter(tosses, stated)
    )  # fmt: skip
    evidence, seen = collect(windows, rivals[0], n_threads=threads), sample.evidence(rivals[0])
    sides, common = [], set.intersection(*(set(rival.names) for rival in rivals))
    for rival in rivals:
        own = [k for k, name in enumerate(rival.owners) if name not in common]  # what all have is taken as known
        earlier = sums(replace(seen, residuals=seen.residuals_of(rival)), slopes(seen, rival, own), sample.n)
        sides.append(_Side(evidence.residuals_of(rival), slopes(evidence, rival, own), earlier.H.sum(0)))
    nearest = np.full(len(good), np.inf)
    for one, other in combinations(sides, 2):
        squares = [_left_after_refit(*pair, evidence, len(good)) for pair in ((one, other), (other, one))]
        nearest = np.minimum(nearest, np.sqrt(np.mean(squares, axis=0)))
    out[good] = nearest
    return out


class _Side(NamedTuple):
    """A hypothesis in the windows of B tosses: residuals, their derivatives, and the (P, P) earlier information."""

    residuals: Array
    J: Array
    held: Array


def _left_after_refit(right: _Side, wrong: _Side, evidence: Evidence, n: int) -> Array:
    """(n,) squared separation of each toss if one hypothesis is right and the wrong one is fitted again."""
    toss, inside, density = evidence.windows.toss, evidence.windows.inside[..., None], evidence.density
    nu = density.degrees_of_freedom
    r, J = np.where(inside, wrong.residuals - right.residuals, 0.0), np.where(inside[..., None], wrong.J, 0.0)
    weighted = J * ((nu + 1) / (nu + r[..., None] ** 2))
    g, H = np.zeros((n, J.shape[-1])), np.tile(wrong.held + 1e-9 * np.eye(len(wrong.held)), (n, 1, 1))
    np.add.at(g, toss, np.einsum("wlkp,wlk->wp", weighted, r))
    np.add.at(H, toss, np.einsum("wlkp,wlkq->wpq", weighted, J))
    step = -np.linalg.solve(H, g[..., None])[..., 0]
    left = student_deviance(r + np.einsum("wlkp,wp->wlk", J, step[toss]), density).sum((1, 2))
    total = np.bincount(toss, weights=left, minlength=n) + np.einsum("np,pq,nq->n", step, wrong.held, step)
    return np.asarray(nu / (nu + 1) * total, dtype=float)  # squares of small residuals


def _as_toss(q: Array, v0: Array, dt: float, cov: Array) -> Toss:
    """A predicted motion (T, nq) as a toss, with velocities by differences: windows hardly trust them."""
    n = len(q)
    v = np.concatenate([v0[None], difference(q[1:], q[:-1]) / dt])
    same = np.broadcast_to(cov, (n, *cov.shape))
    phase = np.full(n, int(Phase.UNKNOWN), dtype=np.uint8)
    times: Array = np.arange(n, dtype=float) * dt
    return Toss("predicted", times, q, v, same, same, phase)
