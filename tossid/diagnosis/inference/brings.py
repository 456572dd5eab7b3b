"""What the changes bring: whole tosses that took no part, predicted before and after them.

A short window starts from what its own frames say. A person runs a simulator from the release to the end. So each toss
is rolled out open loop from the first state that its flight determines, by what was chosen and fitted without it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.findings import Brings, Felt, WholeToss
from tossid.diagnosis.inference.found import Found
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.judge import Fold
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.diagnosis.localisation.rollouts import (
    distances,
    first_states,
    measured_again,
    rolled_out,
    toss_errors,
    whole_motions,
)
from tossid.types import Toss

Array = NDArray[np.float64]
NOISE_DRAWS = 4
"""Of noise and of parameters, for the limit below which whole tosses feel nothing but these."""
Runs = Callable[[Hypothesis, Sequence[Toss], Sample], list[Array]]
"""Poses (n, nq) of each whole toss's frames; NaN where one diverged, or was not run."""


def runs_in_tossid(hypothesis: Hypothesis, tosses: Sequence[Toss], sample: Sample) -> list[Array]:
    """`Runs` in tossid's own simulator, or in a user's that is called from Python.

    Args:
        hypothesis: What predicts.
        tosses: m of them.
        sample: Their windows.
    """
    return rolled_out(tosses, hypothesis.world(), sample.windows, n_threads=sample.n_threads)


def whole_tosses(
    folds: Sequence[Fold],
    tosses: Sequence[Toss],
    stated: Hypothesis,
    *,
    engine: Literal["mujoco", "python", "tossid"] = "tossid",
    runs: Runs = runs_in_tossid,
    unseen: bool = True,
    n_threads: int = 1,
) -> Brings:
    """What was found without each toss brings for it.

    Args:
        folds: Of `judge.cross_fit`.
        tosses: All of them.
        stated: The simulator as it is stated.
        engine: Of the runs.
        runs: Of whole tosses under a hypothesis.
        unseen: Whether the folds' tosses took no part.
        n_threads: Of simulators.
    """
    before, after = ([np.full_like(toss.q, np.nan) for toss in tosses] for _ in range(2))
    for fold in folds:
        held, part = _part(fold, tosses, n_threads)
        was = runs(stated, held, part)
        now = was if fold.after is fold.before else runs(fold.found.hypothesis, held, part)
        for i, one, other in zip(fold.held.tolist(), was, now, strict=True):
            before[i], after[i] = one, other
    return brings_of(tosses, before, after, width=stated.base.object.width, engine=engine, unseen=unseen)


def brings_of(
    tosses: Sequence[Toss],
    before: Sequence[Array],
    after: Sequence[Array],
    *,
    width: float,
    engine: Literal["mujoco", "python", "tossid"] = "tossid",
    unseen: bool = True,
) -> Brings:
    """Errors of whole tosses before and after, and the worst toss itself.

    Args:
        tosses: B, as recorded.
        before: B predicted motions (n, nq).
        after: B with the changes.
        width: Of the object [m].
        engine: Of the predictions.
        unseen: Whether the tosses took no part.
    """
    recorded = [toss.q for toss in tosses]
    errors = [distances(runs, recorded, width) for runs in (before, after)]
    far = np.where(np.isfinite(errors).all((0, 2)), errors[0][:, 0], -np.inf)
    i = int(far.argmax())
    worst = WholeToss(tosses[i].name, tosses[i].t - tosses[i].t[0], recorded[i], before[i], after[i])
    return Brings(engine, errors[0], errors[1], width, unseen, worst if np.isfinite(far[i]) else None)


def worsen(folds: Sequence[Fold], tosses: Sequence[Toss], names: Sequence[str], n_threads: int = 1) -> set[str]:
    """Effects with which whole tosses that took no part are predicted worse, by more than a person would notice.

    Args:
        folds: Of `judge.cross_fit`.
        tosses: All of them.
        names: Of the effects.
        n_threads: Of simulators.
    """
    worse: dict[str, list[Array]] = {name: [] for name in names}
    for fold in folds:
        held, part = _part(fold, tosses, n_threads)
        h = fold.found.hypothesis
        inside = [name for name in names if name in h.names]
        whole = _errors(h, held, part) if inside else np.zeros((len(held), 2))
        for name in inside:
            worse[name].append(whole - _errors(h.without(name), held, part))
    medians = {name: np.nanmedian(np.concatenate(each), axis=0) for name, each in worse.items() if each}
    return {name for name, median in medians.items() if Felt(float(median[0]), float(median[1])).is_over()}


def _errors(hypothesis: Hypothesis, tosses: Sequence[Toss], sample: Sample) -> Array:
    return toss_errors(tosses, hypothesis.world(), sample.windows, n_threads=sample.n_threads)


def _part(fold: Fold, tosses: Sequence[Toss], n_threads: int) -> tuple[list[Toss], Sample]:
    """The judged tosses of a fold, and their windows."""
    return [tosses[i] for i in fold.held.tolist()], Sample(fold.before.windows, len(fold.held), n_threads)


def felt_of_each(hypothesis: Hypothesis, tosses: Sequence[Toss], sample: Sample) -> dict[str, Felt]:
    """How whole tosses change when each effect is taken out, from the same first states: medians over tosses.

    Medians, because contact turns any change into a large one in a few tosses.

    Args:
        hypothesis: With the effects.
        tosses: Rolled out.
        sample: Their windows.
    """
    if not hypothesis.effects:
        return {}
    w, threads, width = sample.windows, sample.n_threads, hypothesis.base.object.width
    first = first_states(tosses, hypothesis.world(), w, n_threads=threads)
    whole = whole_motions(tosses, hypothesis.world(), first, w, threads)
    out = {}
    for name in hypothesis.names:
        without = whole_motions(tosses, hypothesis.without(name).world(), first, w, threads)
        out[name] = median_of(distances(whole, without, width))
    return out


def noise_limit(found: Found, tosses: Sequence[Toss], sample: Sample, *, folds: int, seed: int) -> Felt:
    """What noise alone makes of whole tosses: how what was found predicts tosses that it makes itself.

    Their first states are estimated from measurements with the same noise, as of recorded tosses, and parameters are
    drawn from their covariance: noise has made both uncertain. Two standard deviations above the mean of the draws.

    Args:
        found: By a search.
        tosses: As recorded.
        sample: Their windows.
        folds: Parts of the tosses without each of which values were fitted that predict it; 0 if with all.
        seed: Of the noise.
    """
    # without a fold, values are that much less certain
    wider = np.sqrt(folds / (folds - 1)) if folds > 1 else 1.0
    threads, medians, runs = sample.n_threads, [], runs_in_tossid(found.hypothesis, tosses, sample)
    for rng in np.random.default_rng(seed).spawn(NOISE_DRAWS):
        seed_of_draw = int(rng.integers(2**31))
        made = measured_again(tosses, runs, draws=1, seed=seed_of_draw)
        if made:
            world = drawn(found, rng, wider).world()
            windows = make_windows(made, world.object, settings=sample.windows.settings)
            felt = median_of(toss_errors(made, world, windows, n_threads=threads))
            medians.append((felt.position_pct, felt.rotation_deg))
    if not medians:
        return Felt(0.0, 0.0)
    position, rotation = np.mean(medians, axis=0) + 2 * np.std(medians, axis=0, ddof=1)
    return Felt(float(position), float(rotation))


def drawn(found: Found, rng: np.random.Generator, wider: float = 1.0) -> Hypothesis:
    """A hypothesis with parameters drawn from a normal distribution about their values.

    Args:
        found: By a search: the values, and the covariances of their fits.
        rng: Of the draw.
        wider: Factor of the standard deviations.
    """
    h, flat = found.hypothesis, found.hypothesis.flat()
    for fitted in (found.fit, found.flight):
        if fitted is None or not fitted.free:
            continue
        moved = rng.multivariate_normal(np.zeros(len(fitted.free)), fitted.columns.covariance(), method="eigh")
        for name in fitted.hypothesis.names:
            own = fitted.columns_of(name)
            if own and found.fit_of(name) is fitted:
                place = h.place_of(name)
                flat[place] += wider * moved[own] * h.steps[place]
    return h.at(flat)


def median_of(errors: Array) -> Felt:
    """Medians over tosses (n, 2); what diverges is infinitely far.

    Args:
        errors: Position [% of the width] and rotation [deg].
    """
    position, rotation = np.median(np.where(np.isfinite(errors), errors, np.inf), axis=0)
    return Felt(float(position), float(rotation))
