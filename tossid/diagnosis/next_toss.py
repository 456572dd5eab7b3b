"""The next toss: the release that best separates the hypotheses which the tosses so far cannot distinguish.

For a release, the toss is predicted under the first hypothesis, noise-free but with the data's noise stated, and cut
into windows as recorded ones are. The difference between two hypotheses there, whitened with the first states as
nuisance parameters, has the squared length that a diagnosis would find on average beyond noise. Residuals count by
Student's density, as in a fit, so that one chaotic impact does not decide.

The hypothesis that is wrong would be fitted again, and so take back a part of the difference. What is left after a
Gauss-Newton step of its own parameters counts, with the earlier tosses as what holds them (T-optimality; Atkinson and
Fedorov, "The design of experiments for discriminating between two rival models", Biometrika 62 (1975)). Either of two
hypotheses may be the right one, and the mean of both cases is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.evidence import Evidence, Hypothesis
from tossid.diagnosis.likelihood.states import difference
from tossid.diagnosis.likelihood.whitening import linearise
from tossid.diagnosis.likelihood.windows import make_windows, steps_of
from tossid.motion import lowest_corner
from tossid.objects import ObjectModel
from tossid.rotations import quat_rotate
from tossid.settings.diagnosis.diagnose import DiagnoseSettings, NextTossSettings
from tossid.types import Phase, Toss, frame_time

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Releases:
    """First states of B tosses, as they would be recorded.

    Attributes:
        q: (B, nq) poses.
        v: (B, nv) velocities.
    """

    q: Array
    v: Array

    def __len__(self) -> int:
        """B."""
        return len(self.q)


def next_toss(
    hypothesis: Hypothesis,
    alternatives: Sequence[Hypothesis],
    tosses: Sequence[Toss],
    stated: ObjectModel,
    *,
    rng: np.random.Generator,
    n_threads: int = 1,
    settings: DiagnoseSettings = DiagnoseSettings(),
) -> dict[str, Any]:
    """gap.json's "next_toss"; {"release": None, "reason": ...} where nothing is confusable or nothing separates.

    Args:
        hypothesis: With the named effects.
        alternatives: With another effect of a confusable class in one's place.
        tosses: So far: their releases are feasible, and their covariances are the noise.
        stated: The dataset's object.
        rng: For the draw of releases.
        n_threads: Of the simulator.
        settings: Of the diagnosis.
    """
    own = settings.next_toss
    if not alternatives:
        return {"release": None, "reason": "no two effects are confusable: no toss is needed to separate them"}
    rivals = [hypothesis, *alternatives][: own.hypotheses]
    names = _what_differs(rivals)
    candidates = draw_releases(tosses, stated, own.candidates, rng=rng, settings=own)
    some = tosses[:: -(-len(tosses) // own.earlier_tosses)]
    earlier = Releases(np.stack([toss.q[0] for toss in some]), np.stack([toss.v[0] for toss in some]))
    frames = int(np.median([len(toss) for toss in tosses])) - 1

    both = Releases(np.concatenate([candidates.q, earlier.q]), np.concatenate([candidates.v, earlier.v]))
    expected = separations(rivals, both, tosses, frames, n_threads=n_threads, settings=settings)
    expected, usual = expected[: len(candidates)], float(np.median(expected[len(candidates) :]))
    best = int(np.argmax(expected))
    if not expected[best] > own.least_separation:
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
    """The effects of each hypothesis that not all of them have."""
    all_of = [{effect.name for effect in rival.effects} for rival in rivals]
    common = set.intersection(*all_of)
    kept = [[e.name for e in rival.effects if e.name not in common] for rival in rivals]
    return [" + ".join(names) or "neither" for names in kept]


def draw_releases(
    tosses: Sequence[Toss],
    stated: ObjectModel,
    n: int,
    *,
    rng: np.random.Generator,
    settings: NextTossSettings = NextTossSettings(),
) -> Releases:
    """Feasible releases: heights, speeds and spins from widened ranges of earlier ones; any attitude and heading.

    Args:
        tosses: Earlier ones.
        stated: Their object.
        n: How many.
        rng: For the draw.
        settings: By how much ranges are widened.
    """

    def between(values: Array, least: float = -np.inf) -> Array:
        """(n,) uniform draws from the widened range of some values."""
        low, high = float(values.min()), float(values.max())
        room = 0.5 * settings.widened * (high - low)
        low, high = max(low - room, least), max(high + room, least)
        return rng.uniform(low, high, n)

    q0, v0 = np.stack([toss.q[0] for toss in tosses]), np.stack([toss.v[0] for toss in tosses])
    reach = float(np.linalg.norm(stated.drawn.corner_pos, axis=1).max())
    x, y = between(q0[:, 0]), between(q0[:, 1])
    low = between(lowest_corner(stated, q0), settings.clearance)
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
    return Releases(q, np.concatenate([linear, spin[:, None] * axis, rates], axis=1))


def separations(
    rivals: Sequence[Hypothesis],
    releases: Releases,
    tosses: Sequence[Toss],
    frames: int,
    *,
    n_threads: int = 1,
    settings: DiagnoseSettings = DiagnoseSettings(),
) -> Array:
    """(B,) expected separation of the two nearest rivals by one toss from each release [standard deviations].

    Args:
        rivals: The hypotheses.
        releases: B of them.
        tosses: Earlier ones, whose covariances are the noise, and which hold the rivals' parameters.
        frames: Of a toss.
        n_threads: Of the simulator.
        settings: Of the diagnosis.
    """
    likelihood = settings.likelihood
    dt = frame_time(tosses)
    cov = np.median(np.concatenate([toss.measured[1] for toss in tosses]), axis=0)
    first = rivals[0].world()
    steps = np.full(len(releases), min(frames, settings.next_toss.frames))
    how = steps_of(first, likelihood.simulation)
    run = first.roll_out(releases.q, releases.v, n_steps=steps, dt=dt, **how, n_threads=n_threads)
    good = np.flatnonzero(np.isfinite(run).all((1, 2)))
    out = np.zeros(len(releases))
    if not len(good):
        return out
    windows = make_windows([_as_toss(run[b], releases.v[b], dt, cov) for b in good], settings=likelihood)
    evidence = Evidence(*linearise(windows, first, refine=0, n_threads=n_threads), n_threads)
    seen = Evidence(*linearise(make_windows(tosses, settings=likelihood), first, n_threads=n_threads), n_threads)
    nu, nearest = likelihood.density.degrees_of_freedom, np.full(len(good), np.inf)
    sides = []
    for rival, own in zip(rivals, _own_parameters(rivals), strict=True):
        J = _derivatives(seen, rival, own)
        held = np.einsum("wlkp,wlkq->pq", J / (1 + seen.residuals(rival.world())[..., None] ** 2 / nu), J)
        sides.append(_Side(evidence.residuals(rival.world()), _derivatives(evidence, rival, own), held))
    for one, other in combinations(sides, 2):
        squares = [_left_after_refit(*pair, evidence, len(good), nu) for pair in ((one, other), (other, one))]
        nearest = np.minimum(nearest, np.sqrt(np.mean(squares, axis=0)))
    out[good] = nearest
    return out


class _Side(NamedTuple):
    """A hypothesis in the windows of B tosses: residuals, their derivatives, and the (P, P) earlier information."""

    residuals: Array
    J: Array
    held: Array


def _own_parameters(rivals: Sequence[Hypothesis]) -> list[NDArray[np.intp]]:
    """Of each hypothesis, places of the parameters of effects that not all have; what all have is taken as known."""
    common = set.intersection(*({effect.name for effect in rival.effects} for rival in rivals))
    return [
        np.array([i for i, name in enumerate(rival.parameter_owners) if name not in common], dtype=np.intp)
        for rival in rivals
    ]


def _derivatives(evidence: Evidence, hypothesis: Hypothesis, places: NDArray[np.intp]) -> Array:
    """(W, L, K, P) derivatives of whitened residuals by some parameters, in their steps; 0 outside of windows."""
    here, flat, (_, high) = evidence.residuals(hypothesis.world()), hypothesis.flat(), hypothesis.bounds
    columns = []
    for i in places:
        step = hypothesis.steps[i] * (1 if flat[i] + hypothesis.steps[i] <= high[i] else -1)
        moved = flat.copy()
        moved[i] += step
        change = evidence.residuals(hypothesis.at(moved).world()) - here
        columns.append(np.where(evidence.windows.inside[..., None], change * np.sign(step), 0.0))
    return np.stack(columns, axis=-1) if columns else np.zeros((*here.shape, 0))


def _left_after_refit(right: _Side, wrong: _Side, evidence: Evidence, n: int, nu: float) -> Array:
    """(n,) squared separation of each toss if one hypothesis is right and the wrong one is fitted again."""
    windows = evidence.windows
    r = np.where(windows.inside[..., None], wrong.residuals - right.residuals, 0.0)
    weighted = wrong.J / (1 + r[..., None] ** 2 / nu)
    g, H = np.zeros((n, wrong.J.shape[-1])), np.tile(wrong.held + 1e-9 * np.eye(len(wrong.held)), (n, 1, 1))
    np.add.at(g, windows.toss, np.einsum("wlkp,wlk->wp", weighted, r))
    np.add.at(H, windows.toss, np.einsum("wlkp,wlkq->wpq", weighted, wrong.J))
    step = -np.linalg.solve(H, g[..., None])[..., 0]
    r = r + np.asarray(np.einsum("wlkp,wp->wlk", wrong.J, step[windows.toss]))
    # twice the log-likelihood ratio of Student's density; r² for small r
    squares = nu * np.log1p(r**2 / nu)
    total = np.bincount(windows.toss, weights=squares.sum((1, 2)), minlength=n)
    return np.asarray(total + np.einsum("np,pq,nq->n", step, wrong.held, step), dtype=float)


def _as_toss(q: Array, v0: Array, dt: float, cov: Array) -> Toss:
    """A predicted motion (T, nq) as a toss, with velocities by differences: windows hardly trust them."""
    n = len(q)
    v = np.concatenate([v0[None], difference(q[1:], q[:-1]) / dt])
    same = np.broadcast_to(cov, (n, *cov.shape))
    phase = np.full(n, int(Phase.UNKNOWN), dtype=np.uint8)
    times: Array = np.arange(n, dtype=float) * dt
    return Toss("predicted", times, q, v, same, same, phase)
