"""Effects that are not the same in all tosses: they step at a toss, or drift, over the order of recording.

Whether anything changes, and where, is tested in closed form (`designs`). Which effect changes is compared by
likelihood. Where a change is large, derivatives at one hypothesis are rough. So the likeliest few effects are fitted to
blocks of few tosses, and the same algebra is done with derivatives there: it gives the form, the values of each stretch
or the rate, and their intervals. What else changes is then sought beside a world of its own for each stretch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.inference.columns import Columns, slopes, sums
from tossid.diagnosis.inference.designs import (
    FEWEST,
    LEVEL,
    change_p_values,
    designed,
    enough,
    gain_of,
    line_over,
    steps_at,
    with_step,
)
from tossid.diagnosis.inference.evidence import Evidence, collect, log_likelihood_ratio
from tossid.diagnosis.inference.fitting import Fit, fit
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.screening import Screening, Start
from tossid.diagnosis.inference.stretches import Change, Stretch, fitted_together
from tossid.diagnosis.likelihood.windows import Windows
from tossid.physics.effects import Effect

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SUSPECTS, ROUNDS = 4, 3
"""Effects that are fitted in a round, and effects that change at most."""
ITERATIONS = 4
"""Most steps of a fit to a block."""
LEAST_GAIN = 3.0
"""Of log-likelihood over a constant value, by values that the other tosses determine."""
LIKELY, OF_WORLD = {"measurement": 1.0, "body": 0.5}, 0.9
"""What a gain counts, by the effect's family: a recording changes sooner than the world, and an object hardly does."""
LEAST_SHARE = 0.2
"""Of the first change's gain, that a further one must bring: less may be what hypotheses leave of the first."""
SPECIAL = 0.75
"""Share of an effect's gain from which on a special case of it is the simpler story."""
SHOWN = 0.05
"""P-value, adjusted for all effects, up to which an effect may be the one that changes."""
NO: Index = np.zeros(0, dtype=int)


def alike(one: Effect, other: Effect) -> bool:
    """Whether an effect may do what another leaves when it has changed: it does the same, or one is part of the other.

    Args:
        one: An effect that changes.
        other: Another one, or the same.
    """
    same = {one.name, *one.contains} | one.one_of_group | one.made_of
    return other.name in same or one.name in other.contains


@dataclass(frozen=True)
class OverOrder:
    """What changes over the order.

    Attributes:
        changes: Effects that change, the likeliest first.
        left: The p-value that anything changes beside them; None where tosses are too few to test that.
        place: First toss after a significant change that no effect explains; None without.
    """

    changes: tuple[Change, ...]
    left: float | None
    place: int | None


@dataclass(frozen=True)
class _Suspect:
    """An effect with its starts, and the columns that are active beside it."""

    effect: Effect
    starts: tuple[Start, ...]
    active: Index

    def on(self, part: Evidence, h: Hypothesis, values: Array | None = None) -> Hypothesis:
        """One of its hypotheses in the world of a part, with other values if given."""
        name = self.effect.name
        here = replace(h.without(*({*h.names} - {*part.hypothesis.names, name})), base=part.hypothesis.base)
        if values is None:
            return here
        flat = here.flat()
        flat[here.place_of(name)] = values
        return here.at(flat)


@dataclass(frozen=True)
class _Beside:
    """Tosses in their order, each under the hypothesis of its part, and columns of what may change beside that."""

    parts: tuple[Evidence, ...]
    edges: tuple[int, ...]
    columns: Columns
    suspects: tuple[_Suspect, ...]

    def part_of(self, a: int, b: int) -> Evidence:
        """The evidence of tosses of one part."""
        k = int(np.searchsorted(self.edges, a, side="right")) - 1
        return self.parts[k].of_tosses(np.arange(a, b) - self.edges[k])

    def after(self, change: Change, fitted: Fit, windows: Callable[[Sequence[int]], Windows] | None) -> _Beside:
        """With a change in each part's world. What is left of it is no effect that does the same."""
        effect, name = change.effect, change.effect.name
        new = np.flatnonzero(np.any(np.diff(change.values, axis=0) != 0, axis=1)) + 1
        edges, parts, sums_of = tuple(sorted({*self.edges, *new.tolist()})), list[Evidence](), list[Columns]()
        all_windows = None if windows is None else windows(edges)
        kept = tuple(s for s in self.suspects if not alike(effect, s.effect))
        owners = [owner for j, owner in enumerate(fitted.hypothesis.owners) if j in fitted.free]
        free = [owner for owner in owners if owner in self.parts[0].hypothesis.names and owner != name]
        for a, b in pairwise(edges):
            before = self.part_of(a, b)
            h = replace(before.hypothesis.without(name), base=effect.at(before.hypothesis.base, change.values[a]))
            own = before.windows if all_windows is None else all_windows.of_tosses(np.arange(a, b))
            part = collect(own, h, n_threads=before.n_threads)
            J = np.zeros((*part.residuals.shape, self.columns.g.shape[1]))
            for each in dict.fromkeys(free):
                place = h.place_of(each)
                J[..., fitted.own(each)] = slopes(part, h, range(place.start, place.stop))
            for s, start in ((each, start) for each in kept for start in each.starts if each.effect.name not in free):
                there = s.on(part, start.hypothesis)
                place = there.place_of(s.effect.name)
                secant = (part.residuals_of(there) - part.residuals)[..., None] if start.secant else None
                J[..., start.columns] = (
                    slopes(part, there, range(place.start, place.stop)) if secant is None else secant
                )
            parts.append(part)
            sums_of.append(sums(part, J, b - a))
        H, g = (np.concatenate([getattr(each, of) for each in sums_of]) for of in "Hg")
        return _Beside(tuple(parts), edges, Columns(H, g, self.columns.curvature), kept)


@dataclass(frozen=True)
class _Local:
    """An effect fitted to blocks of tosses: its columns there, counted from zero, and fitted values (n, P) in steps."""

    suspect: _Suspect
    columns: Columns
    values: Array
    gain: float

    @staticmethod
    def of(suspect: _Suspect, fits: Sequence[Fit], gain: float) -> _Local:
        """From fits to tosses that follow each other, of the effect alone."""
        values, H, g = list[Array](), list[Array](), list[Array]()
        for each in fits:
            own = each.hypothesis.values_of(suspect.effect.name) / [p.step for p in suspect.effect.parameters]
            values.append(np.tile(own, (each.n, 1)))
            H.append(each.columns.H)
            g.append(each.columns.g - each.columns.H @ own)
        columns = Columns(np.concatenate(H), np.concatenate(g), fits[0].columns.curvature)
        return _Local(suspect, columns, np.concatenate(values), gain)

    def designed(self, design: Array, a: int = 0) -> Columns:
        """Columns of a design of some tosses, from a on."""
        b, own = a + len(design), np.arange(self.values.shape[1])
        return designed(self.columns.of_tosses(a, b), NO, own, design)

    def within(self, values: Array) -> Array:
        """Values (..., P) in steps, within their bounds."""
        low, high, step = np.array([(p.low, p.high, p.step) for p in self.suspect.effect.parameters]).T
        return np.clip(values, low / step, high / step)

    def gain_of(self, design: Array) -> float:
        """Of log-likelihood, by a design whose values in a toss the others determine."""
        steps = self.designed(design).left_out().reshape(len(design), design.shape[1], -1)
        values = self.within(np.einsum("nq,nqp->np", design, steps))
        return self.gain + float((self.columns.gains(values) - self.columns.gains(self.values)).sum())

    def form(self, known: Sequence[int], seed: int) -> tuple[float, tuple[int, ...] | None]:
        """The gain of the form that gains more, and the edges of its stretches; None for a drift."""
        n, own = len(self.values), np.arange(self.values.shape[1])
        edges: tuple[int, ...] = (0, n)
        found = with_step(self.columns, NO, own, edges, known)[1]
        while found != edges:
            edges = found
            for a, b in pairwise(edges):
                part, inner = self.designed(np.ones((b - a, 1)), a), [k - a for k in known]
                if enough(b - a) and change_p_values([[(part, NO, own)]], inner, seed)[0][0] <= LEVEL:
                    more, cut = with_step(part, NO, own, (0, b - a), inner)
                    if more > gain_of(part, NO, own, np.ones((b - a, 1))):
                        found = tuple(sorted({*edges, *(a + k for k in cut)}))
                        break
        line, steps = self.gain_of(line_over(n)), self.gain_of(steps_at(edges))
        steps -= len({*edges[1:-1]} - {*known}) * float(np.log(n))
        return (line, None) if line > steps else (steps, edges)

    def described(self, edges: Sequence[int] | None, p_value: float, gain: float) -> Change:
        """The change in a form, with intervals by the jackknife over the tosses that determine them."""
        effect, n, P = self.suspect.effect, len(self.values), self.values.shape[1]
        size = np.array([p.step for p in effect.parameters])

        def intervals(design: Array, a: int, rows: Array) -> list[dict[str, Interval]]:
            """Of rows (r, q) of combinations of the design's coefficients."""
            some = self.designed(design, a)
            B, out = some.step(), []
            cov = Columns(some.H, some.g + some.H @ B, some.curvature).covariance()
            t = student_t.ppf(0.975, max(len(design) - design.shape[1], 1))
            for row in rows:
                X = np.kron(row, np.eye(P))
                half = t * np.sqrt(np.maximum(np.diag(X @ cov @ X.T), 0.0)) * size
                ends = zip(effect.parameters, X @ B * size, half, strict=True)
                out.append({p.name: Interval(float(x), float(x - h), float(x + h)) for p, x, h in ends})
            return out

        design = line_over(n) if edges is None else steps_at(edges)
        values = self.within(design @ self.designed(design).step().reshape(-1, P)) * size
        if edges is None:
            first, last, rate = intervals(design, 0, np.array([design[0], design[-1], [0.0, 1.0]]))
            ends = (Stretch(0, 1, first), Stretch(n - 1, n, last))
            return Change(effect, "drift", p_value, gain, ends, rate, values)
        one = np.ones((1, 1))
        parts = (Stretch(a, b, intervals(np.ones((b - a, 1)), a, one)[0]) for a, b in pairwise(edges))
        return Change(effect, "steps", p_value, gain, tuple(parts), {}, values)


def _locally(beside: _Beside, suspect: _Suspect, edges: Iterable[int]) -> _Local:
    """An effect fitted to blocks of few tosses, none of which has an edge within, each from where its columns lead."""
    name, gain, made = suspect.effect.name, 0.0, list[Fit]()
    size = np.array([p.step for p in suspect.effect.parameters])
    for first, stop in pairwise(sorted({*beside.edges, *edges})):
        blocks = np.linspace(first, stop, max((stop - first) // FEWEST, 1) + 1).round().astype(int)
        for a, b in pairwise(blocks.tolist()):
            part, begun = beside.part_of(a, b), list[Hypothesis]()
            for start in suspect.starts:
                columns = beside.columns.part(start.columns).of_tosses(a, b)
                h, step = suspect.on(part, start.hypothesis), np.clip(columns.step(), -100, 100)
                begun.append(h if start.secant else suspect.on(part, h, h.values_of(name) + step * size))
            if made:
                begun.append(suspect.on(part, begun[0], made[-1].hypothesis.values_of(name)))
            near = max((_reached(part, h) for h in begun), key=lambda e: float(log_likelihood_ratio(e, part).sum()))
            held = frozenset(near.hypothesis.names) - {name}
            made.append(fit(near, near.hypothesis, n=b - a, iterations=ITERATIONS, held=held))
            gain += float(log_likelihood_ratio(made[-1].evidence, part).sum())
    return _Local.of(suspect, made, gain)


def _reached(part: Evidence, h: Hypothesis) -> Evidence:
    """The evidence of a hypothesis far away: from the recording, where the first states of the present one feel none.

    Objects that rest above the stated ground do not feel that it is somewhat higher.
    """
    near = part.near(h, steps=2)
    return collect(part.windows, h, n_threads=part.n_threads) if np.array_equal(near.raw, part.raw) else near


def _constant_gain(beside: _Beside, suspect: _Suspect, values: Array) -> float:
    """What the likeliest of some values (m, P) gains if all tosses have it, or nothing of the effect."""

    def gain(each: Array, part: Evidence) -> float:
        there = part.near(suspect.on(part, suspect.starts[0].hypothesis, each), steps=3)
        return float(log_likelihood_ratio(there, part).sum())

    return max(0.0, *(sum(gain(each, part) for part in beside.parts) for each in values))


def _likeliest(
    beside: _Beside, p_values: Array, places: Array, known: Sequence[int], seed: int, only: str = ""
) -> Change | None:
    """The effect whose change explains most; None if none does."""
    n, made = beside.columns.n, list[tuple[float, float, Change]]()

    def weight(effect: Effect) -> float:
        return LIKELY.get(effect.family, OF_WORLD)

    def closed(s: _Suspect, start: Start) -> float:
        """The gain of a change over a constant value, with derivatives at one hypothesis."""
        where = beside.columns, s.active, start.columns
        change = max(with_step(*where, (0, n), known)[0], gain_of(*where, line_over(n)))
        return weight(s.effect) * (change - gain_of(*where, np.ones((n, 1))))

    likely = [k for k, s in enumerate(beside.suspects) if only == s.effect.name or (not only and p_values[k] <= SHOWN)]
    gains = {k: max(closed(beside.suspects[k], start) for start in beside.suspects[k].starts) for k in likely}

    def fit_in_form(k: int) -> None:
        suspect, place = beside.suspects[k], int(places[k])
        local = _locally(beside, suspect, (place,))
        gain, edges = local.form(known, seed)
        if edges is not None and place not in edges:
            local = _locally(beside, suspect, edges)
            gain, edges = local.form(known, seed)
        change = local.described(edges, float(p_values.min()), gain)
        constants = np.stack([change.values[0], change.values[-1], change.values.mean(0)])
        over_constant = gain - _constant_gain(beside, suspect, constants)
        if over_constant > LEAST_GAIN:
            made.append((weight(suspect.effect) * gain, gain, replace(change, gain=over_constant)))

    # What is gained over a constant value lacks what that takes of the change, more for one effect than for another. So
    # the whole gains are compared, and then those of what does nearly the same as the best.
    tried = sorted(likely, key=lambda k: -gains[k])[:SUSPECTS]
    for k in tried:
        fit_in_form(k)
    if not made:
        return None
    best = max(made, key=lambda each: each[0])[2].effect
    near = best.one_of_group | best.made_of | {*best.contains}
    for k, suspect in enumerate(beside.suspects):
        if k not in tried and suspect.effect.name in near:
            fit_in_form(k)
    chosen = max(made, key=lambda each: each[0])
    while inner := [e for e in made if e[2].effect.name in chosen[2].effect.contains and e[1] > SPECIAL * chosen[1]]:
        chosen = max(inner, key=lambda each: each[1])
    return chosen[2]


def over_order(
    present: Fit,
    screening: Screening,
    *,
    boundaries: Sequence[int] = (),
    windows: Callable[[Sequence[int]], Windows] | None = None,
    seed: int = 0,
    level: float = LEVEL,
) -> OverOrder:
    """What changes over the order of recording, beside a hypothesis.

    Args:
        present: The hypothesis, whose tosses are in the order of recording.
        screening: The library beside it.
        boundaries: First tosses of sessions of the dataset, but for the first session.
        windows: Of all tosses, given the edges of stretches between which something has changed: a tracker's slow
            errors are what scatters within stretches (`windows_within`). If None, they stay as they are.
        seed: Of the orders that are drawn.
        level: Of the first change; of further ones it is `LEVEL`.
    """
    found = _sought(present, screening, tuple(boundaries), windows, seed, level)
    if not found.changes or any(change.form == "drift" for change in found.changes):
        return found
    return replace(found, changes=fitted_together(present.evidence, found.changes, windows))


def _sought(
    present: Fit,
    screening: Screening,
    boundaries: Sequence[int],
    windows: Callable[[Sequence[int]], Windows] | None,
    seed: int,
    level: float,
) -> OverOrder:
    """What changes, with values as they were found one effect after the other."""
    h, active, changes = present.hypothesis, screening.active, list[Change]()
    columns_of = {name: np.asarray(present.own(name), dtype=int) for name in h.names}
    suspects = [
        _Suspect(h.effect(name), (Start(h, own, False),), np.setdiff1d(active, own))
        for name, own in columns_of.items()
        if len(own)
    ]
    suspects += [_Suspect(c.effect, c.starts, active) for c in screening.candidates if c.effect is not None]
    alone = beside = _Beside((present.evidence,), (0, present.n), screening.columns, tuple(suspects))
    while enough(present.n) and beside.suspects:
        effects = [[(beside.columns, s.active, start.columns) for start in s.starts] for s in beside.suspects]
        p_values, places = change_p_values(effects, boundaries, seed)
        left = float(p_values.min())
        if left > (LEVEL if changes else level):
            return OverOrder(tuple(changes), left, None)
        change = _likeliest(beside, p_values, places, boundaries, seed) if len(changes) < ROUNDS else None
        if change is None or (changes and change.gain < LEAST_SHARE * changes[0].gain):
            return OverOrder(tuple(changes), left, int(places[p_values.argmin()]))
        if len(changes) == 1 and change.gain > changes[0].gain:
            # what gains more beside another than that alone may explain it
            names = [s.effect.name for s in alone.suspects]
            at = np.full(len(names), change.stretches[-1].first)
            first = _likeliest(alone, np.full(len(names), changes[0].p_value), at, boundaries, seed, change.effect.name)
            if first is not None and first.gain > changes[0].gain:
                changes, beside, change = [], alone, first
        changes.append(change)
        beside = beside.after(change, present, windows)
    return OverOrder(tuple(changes), None, None)
