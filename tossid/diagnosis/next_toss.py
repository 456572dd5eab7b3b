"""The toss to make next: the release that best separates the hypotheses which the tosses so far cannot tell apart.

For a release, tosses are predicted under the first hypothesis, noise-free but with the data's noise stated, and cut
into the same windows as real ones. What two hypotheses differ by there, whitened so that the first states stay the
nuisances that they are, has the squared length that a diagnosis would find on average beyond noise. Misses count by
Student's density, as in the fit, so that one chaotic impact is one impact. All hypotheses keep the values that they
were fitted with: what a refit would take back is not counted, and separations are upper bounds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.evidence import NU, Hypothesis
from tossid.diagnosis.whitening import linearise
from tossid.diagnosis.windows import difference, make_windows, steps_of
from tossid.motion import lowest_corner
from tossid.objects import ObjectModel
from tossid.rotations import quat_rotate
from tossid.types import Phase, Toss

Array = NDArray[np.float64]

CANDIDATES = 200
WIDENED = 0.5
"""Share by which ranges of what was seen are widened."""
CLEARANCE = 0.02
"""Least height [m] of the lowest corner at release."""
LARGEST = 3
"""Hypotheses that are compared."""
MOST_FRAMES = 100
"""Frames of a toss that are predicted."""
MOST_SEEN = 20
"""Tosses seen that releases are compared with."""
ENOUGH = 3.0
"""Expected separation [standard deviations] below which no toss is worth its while."""


@dataclass(frozen=True)
class Releases:
    """First states (B, nq), (B, nv), as they would be recorded."""

    q: Array
    v: Array

    def __len__(self) -> int:
        return len(self.q)


def next_toss(
    hypothesis: Hypothesis,
    alternatives: Sequence[Hypothesis],
    tosses: Sequence[Toss],
    stated: ObjectModel,
    *,
    rng: np.random.Generator,
    n_threads: int = 1,
) -> dict[str, Any]:
    """gap.json's "next_toss": {"release": null, "reason"} where nothing is confusable or nothing separates.

    Args:
        alternatives: the hypothesis with a confusable effect swapped in.
        tosses: those seen: their releases say what is feasible, their covariances what noise is.
        stated: the dataset's object.
    """
    if not alternatives:
        return {"release": None, "reason": "no two effects are confusable: no toss is needed to separate them"}
    rivals = [hypothesis, *alternatives][:LARGEST]
    names = _what_differs(rivals)
    candidates = draw_releases(tosses, stated, CANDIDATES, rng=rng)
    some = tosses[:: -(-len(tosses) // MOST_SEEN)]
    seen = Releases(np.stack([toss.q[0] for toss in some]), np.stack([toss.v[0] for toss in some]))
    frames = int(np.median([len(toss) for toss in tosses])) - 1
    expected = separations(rivals, candidates, tosses, frames, n_threads=n_threads)
    usual = float(np.median(separations(rivals, seen, tosses, frames, n_threads=n_threads)))
    best = int(np.argmax(expected))
    if not expected[best] > ENOUGH:
        reason = (
            f"none of {len(candidates)} feasible releases separates {' and '.join(names)} by more than "
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
        "candidates": len(candidates),
    }


def _what_differs(rivals: Sequence[Hypothesis]) -> list[str]:
    """The effects of each that not all have."""
    all_of = [{effect.name for effect in rival.effects} for rival in rivals]
    common = set.intersection(*all_of)
    kept = [[e.name for e in rival.effects if e.name not in common] for rival in rivals]
    return [" + ".join(names) or "neither" for names in kept]


def draw_releases(tosses: Sequence[Toss], stated: ObjectModel, n: int, *, rng: np.random.Generator) -> Releases:
    """Feasible releases: heights, speeds and spins from the ranges seen, widened by half; any attitude and heading."""
    q0, v0 = np.stack([toss.q[0] for toss in tosses]), np.stack([toss.v[0] for toss in tosses])
    reach = float(np.linalg.norm(stated.corner_pos, axis=1).max())
    x, y = _between(q0[:, 0], n, rng), _between(q0[:, 1], n, rng)
    low = _between(lowest_corner(stated, q0), n, rng, least=CLEARANCE)
    quat = rng.normal(size=(n, 4))
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    joints, rates = (
        np.stack([_between(each, n, rng) for each in seen.T], axis=1) if seen.shape[1] else np.zeros((n, 0))
        for seen in (q0[:, 7:], v0[:, 6:])
    )
    q = np.concatenate([np.stack([x, y, np.full(n, reach)], axis=1), quat, joints], axis=1)
    q[:, 2] += low - lowest_corner(stated, q)
    heading = rng.uniform(0, 2 * np.pi, n)
    speed = _between(np.hypot(v0[:, 0], v0[:, 1]), n, rng, least=0.0)
    axis = rng.normal(size=(n, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    spin = _between(np.linalg.norm(v0[:, 3:6], axis=1), n, rng, least=0.0)
    climb = _between(v0[:, 2], n, rng)
    linear = np.stack([speed * np.cos(heading), speed * np.sin(heading), climb], axis=1)
    # the base's centre of mass has this velocity, whatever the spin
    linear -= quat_rotate(quat, np.cross(spin[:, None] * axis, stated.com[0]))
    return Releases(q, np.concatenate([linear, spin[:, None] * axis, rates], axis=1))


def _between(seen: Array, n: int, rng: np.random.Generator, *, least: float = -np.inf) -> Array:
    """Draws (n,) from the range of what was seen, widened."""
    low, high = float(seen.min()), float(seen.max())
    room = 0.5 * WIDENED * (high - low)
    low, high = max(low - room, least), max(high + room, least)
    return rng.uniform(low, high, n)


def separations(
    rivals: Sequence[Hypothesis], releases: Releases, tosses: Sequence[Toss], frames: int, *, n_threads: int = 1
) -> Array:
    """(B,) expected separation of the two nearest rivals by one toss from each release [standard deviations]."""
    dt = float(np.median(np.concatenate([np.diff(toss.t) for toss in tosses])))
    cov = np.median(np.concatenate([toss.measured[1] for toss in tosses]), axis=0)
    first, *others = [rival.world() for rival in rivals]
    steps = np.full(len(releases), min(frames, MOST_FRAMES))
    run = first.roll_out(releases.q, releases.v, n_steps=steps, dt=dt, **steps_of(first), n_threads=n_threads)
    good = np.flatnonzero(np.isfinite(run).all((1, 2)))
    out = np.zeros(len(releases))
    if not len(good):
        return out
    windows = make_windows([_as_toss(run[b], releases.v[b], dt, cov) for b in good])
    windows, whitening = linearise(windows, first, refine=0, n_threads=n_threads)
    missed = [whitening(windows.misses(windows.predicted(w, n_threads=n_threads))) for w in (first, *others)]
    nearest = np.full(len(good), np.inf)
    for one, other in combinations(missed, 2):
        r = np.where(windows.inside[..., None], other - one, 0.0)
        # twice the log-likelihood ratio of Student's density; r² for small r
        squares = NU * np.log1p(r**2 / NU)
        total = np.bincount(windows.toss, weights=squares.sum((1, 2)), minlength=len(good))
        nearest = np.minimum(nearest, np.sqrt(total))
    out[good] = nearest
    return out


def _as_toss(q: Array, v0: Array, dt: float, cov: Array) -> Toss:
    """A predicted motion (T, nq) as a toss; velocities by differences, as windows trust them little."""
    n = len(q)
    v = np.concatenate([v0[None], difference(q[1:], q[:-1]) / dt])
    same = np.broadcast_to(cov, (n, *cov.shape))
    phase = np.full(n, int(Phase.UNKNOWN), dtype=np.uint8)
    times: Array = np.arange(n, dtype=float) * dt
    return Toss("predicted", times, q, v, same, same, phase)
