"""Effects that are not the same in all tosses: they step at a toss, or drift, over the order of recording.

Whether anything changes, and where, is tested in closed form (`designs`). Which effect changes is compared by
likelihood. Where a change is large, derivatives at one hypothesis are rough. So the likeliest few effects are fitted to
blocks of few tosses (`stretches`). Changes in these forms are compared beside constant values of each other's effects:
what is the same in all tosses shall count for none of them. What else changes is then sought beside a world of its own
for each stretch.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.inference.columns import Columns, slopes, sums
from tossid.diagnosis.inference.designs import (
    FEWEST,
    LEVEL,
    Where,
    change_p_values,
    enough,
    gain_of,
    line_over,
    with_step,
)
from tossid.diagnosis.inference.evidence import Evidence, collect, log_likelihood_ratio
from tossid.diagnosis.inference.fitting import Fit, fit
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.screening import Screening, Start
from tossid.diagnosis.inference.stretches import Blocks, Change, from_zero
from tossid.physics.effects import Effect

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FITTED, ROUNDS = 4, 3
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


def overlap(one: Effect, other: Effect) -> bool:
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
class MayChange:
    """An effect that may change over the order.

    Attributes:
        effect: The effect.
        starts: Its columns, of each of its starts.
        active: Numbers of the columns of other effects, which are the same in all tosses.
    """

    effect: Effect
    starts: tuple[Start, ...]
    active: Index

    def where(self, columns: Columns) -> list[Where]:
        """Where its columns are among all, for each of its starts.

        Args:
            columns: All of them.
        """
        return [(columns, self.active, start.columns) for start in self.starts]


def may_change(present: Fit, screening: Screening) -> tuple[MayChange, ...]:
    """The effects of a hypothesis whose values are free, and those of the library beside it.

    Args:
        present: The hypothesis.
        screening: The library beside it.
    """
    h, active = present.hypothesis, screening.active
    columns_of = {name: np.asarray(present.columns_of(name), dtype=int) for name in h.names}
    ours = (
        MayChange(h.effect(name), (Start(h, own, False),), np.setdiff1d(active, own))
        for name, own in columns_of.items()
        if len(own)
    )
    return (*ours, *(MayChange(c.effect, c.starts, active) for c in screening.candidates if c.effect is not None))


def _with(part: Evidence, effect: Effect, values: Array | None) -> Hypothesis:
    """The hypothesis of a part with values of an effect within their bounds; those that change nothing if None."""
    h = part.hypothesis.without(effect.name).plus(effect, values)
    return h.at(h.flat())


@dataclass(frozen=True)
class _Segments:
    """Tosses in their order, in parts under a hypothesis each, and columns of what may change beside that."""

    parts: tuple[Evidence, ...]
    edges: tuple[int, ...]
    columns: Columns
    candidates: tuple[MayChange, ...]

    def part_of(self, a: int, b: int) -> Evidence:
        """The evidence of tosses of one part."""
        k = int(np.searchsorted(self.edges, a, side="right")) - 1
        return self.parts[k].of_tosses(np.arange(a, b) - self.edges[k])

    def changed(self, change: Change) -> _Segments:
        """With a change in each part's world, and the columns that there are without."""
        effect, values, parts = change.effect, change.values, list[Evidence]()
        new = np.flatnonzero(np.any(np.diff(values, axis=0) != 0, axis=1)) + 1
        edges = tuple(sorted({*self.edges, *new.tolist()}))
        for a, b in pairwise(edges):
            part = self.part_of(a, b)
            h = replace(part.hypothesis.without(effect.name), base=effect.at(part.hypothesis.base, values[a]))
            parts.append(collect(part.windows, h, n_threads=part.n_threads))
        return replace(self, parts=tuple(parts), edges=edges)

    def gain_over(self, other: _Segments) -> float:
        """Gain of log-likelihood over other hypotheses of the same tosses, which have no further parts."""
        ends = zip(self.parts, pairwise(self.edges), strict=True)
        return sum(float(log_likelihood_ratio(part, other.part_of(a, b)).sum()) for part, (a, b) in ends)

    def after(self, change: Change, fitted: Fit) -> _Segments:
        """With a change in each part's world. What is left of it is no effect that does the same."""
        name, there, sums_of = change.effect.name, self.changed(change), list[Columns]()
        kept = tuple(c for c in self.candidates if not overlap(change.effect, c.effect))
        owners = [owner for j, owner in enumerate(fitted.hypothesis.owners) if j in fitted.free]
        free = [owner for owner in owners if owner in self.parts[0].hypothesis.names and owner != name]
        for part, (a, b) in zip(there.parts, pairwise(there.edges), strict=True):
            J = np.zeros((*part.residuals.shape, self.columns.g.shape[1]))
            for each in dict.fromkeys(free):
                place = part.hypothesis.place_of(each)
                J[..., fitted.columns_of(each)] = slopes(part, part.hypothesis, range(place.start, place.stop))
            for c, start in ((each, start) for each in kept for start in each.starts if each.effect.name not in free):
                h = _with(part, c.effect, start.hypothesis.values_of(c.effect.name))
                place = h.place_of(c.effect.name)
                J[..., start.columns] = (
                    (part.residuals_of(h) - part.residuals)[..., None]
                    if start.secant
                    else slopes(part, h, range(place.start, place.stop))
                )
            sums_of.append(sums(part, J, b - a))
        return replace(there, columns=_joined(sums_of), candidates=kept)

    def gain_of_constant(self, change: Change) -> float:
        """What an effect that may change gains by values that all tosses have, fitted from the likeliest known ones."""

        def gain(parts: Sequence[Evidence]) -> float:
            return replace(self, parts=tuple(parts)).gain_over(self)

        effect, known = change.effect, (None, change.values[0], change.values[-1], change.values.mean(0))
        starts = [[part.relinearised(_with(part, effect, values), steps=3) for part in self.parts] for values in known]
        parts = max(starts, key=gain)
        best, held = gain(parts), frozenset({*parts[0].hypothesis.names} - {effect.name})
        for _ in range(ITERATIONS):
            counts = (b - a for a, b in pairwise(self.edges))
            at = [fit(e, e.hypothesis, n=n, iterations=0, held=held) for e, n in zip(parts, counts, strict=True)]
            step = _joined([each.columns for each in at]).step()
            parts = [each.evidence.relinearised(each.moved(step)) for each in at]
            before, best = best, max(best, gain(parts))
            if best < before + LEAST_GAIN:
                break
        return max(best, 0.0)


def _joined(columns: Sequence[Columns]) -> Columns:
    """Columns of tosses that follow each other."""
    H, g = (np.concatenate([getattr(each, of) for each in columns]) for of in "Hg")
    return Columns(H, g, columns[0].curvature)


def _fitted_to_blocks(segments: _Segments, candidate: MayChange, edges: Iterable[int]) -> Blocks:
    """An effect fitted to blocks of few tosses, none of which has an edge within, each from where its columns lead."""
    name, fits = candidate.effect.name, list[Fit]()
    size = np.array([p.step for p in candidate.effect.parameters])
    for first, stop in pairwise(sorted({*segments.edges, *edges})):
        blocks = np.linspace(first, stop, max((stop - first) // FEWEST, 1) + 1).round().astype(int)
        for a, b in pairwise(blocks.tolist()):
            part, starts = segments.part_of(a, b), list[Hypothesis]()
            for start in candidate.starts:
                columns = segments.columns.part(start.columns).of_tosses(a, b)
                values, step = start.hypothesis.values_of(name), np.clip(columns.step(), -100, 100)
                starts.append(_with(part, candidate.effect, values if start.secant else values + step * size))
            if name in part.hypothesis.names:
                starts.append(part.hypothesis)
            if fits:
                starts.append(_with(part, candidate.effect, fits[-1].hypothesis.values_of(name)))
            near = max(
                (_evidence_at(part, h) for h in starts), key=lambda e: float(log_likelihood_ratio(e, part).sum())
            )
            held = frozenset(near.hypothesis.names) - {name}
            fits.append(fit(near, near.hypothesis, n=b - a, iterations=ITERATIONS, held=held))
    return Blocks(candidate.effect, from_zero(fits, frozenset({name})))


def _evidence_at(part: Evidence, h: Hypothesis) -> Evidence:
    """The evidence of a hypothesis far away: from the recording, where the first states of the present one feel none.

    Objects that rest above the stated ground do not feel that it is somewhat higher.
    """
    near = part.relinearised(h, steps=2)
    return collect(part.windows, h, n_threads=part.n_threads) if np.array_equal(near.raw, part.raw) else near


@dataclass(frozen=True)
class _Fitted:
    """A change, what it gains and what a gain counts, and the tosses with it.

    A gain over the effect's own constant value lacks what that takes of the change, more for one effect than for
    another. A whole gain has what is the same in all tosses, for which only some effects account. So two changes are
    compared each beside a constant value of what the other one changes.
    """

    gain: float
    weight: float
    change: Change
    there: _Segments

    def weighted(self, constant: Change | None = None) -> float:
        """The weighted gain, beside a constant value of another effect if given."""
        return self.weight * (self.gain + (0.0 if constant is None else self.there.gain_of_constant(constant)))


def _likeliest(
    segments: _Segments, p_values: Array, places: Array, known: Sequence[int], seed: int, only: str = ""
) -> Change | None:
    """The effect whose change explains most; None if none does."""
    n, fitted, candidates = segments.columns.n, list[_Fitted](), segments.candidates

    def weight(effect: Effect) -> float:
        return LIKELY.get(effect.family, OF_WORLD)

    def in_closed_form(c: MayChange, start: Start) -> float:
        """The gain of a change over a constant value, with derivatives at one hypothesis."""
        where = segments.columns, c.active, start.columns
        change = max(with_step(*where, (0, n), known)[0], gain_of(*where, line_over(n)))
        return weight(c.effect) * (change - gain_of(*where, np.ones((n, 1))))

    def fit_in_form(k: int) -> None:
        candidate, place = candidates[k], int(places[k])
        blocks = _fitted_to_blocks(segments, candidate, (place,))
        edges = blocks.form(known, seed)
        if edges is not None and place not in edges:
            blocks = _fitted_to_blocks(segments, candidate, edges)
            edges = blocks.form(known, seed)
        change = blocks.change(edges, float(p_values.min()))
        there = segments.changed(change)
        gain = there.gain_over(segments) - blocks.optimism(edges, known)
        over_constant = gain - segments.gain_of_constant(change)
        if over_constant > LEAST_GAIN:
            fitted.append(_Fitted(gain, weight(candidate.effect), replace(change, gain=over_constant), there))

    likely = [k for k, c in enumerate(candidates) if only == c.effect.name or (not only and p_values[k] <= SHOWN)]
    gains = {k: max(in_closed_form(candidates[k], start) for start in candidates[k].starts) for k in likely}
    tried = sorted(likely, key=lambda k: -gains[k])[:FITTED]
    for k in tried:
        fit_in_form(k)
    if not fitted:
        return None
    best = max(fitted, key=_Fitted.weighted).change.effect
    near = best.one_of_group | best.made_of | {*best.contains}
    for k, candidate in enumerate(candidates):
        if k not in tried and candidate.effect.name in near:
            fit_in_form(k)
    chosen, *others = sorted(fitted, key=_Fitted.weighted, reverse=True)
    for each in others:
        chosen = each if each.weighted(chosen.change) > chosen.weighted(each.change) else chosen
    while inner := [
        e for e in fitted if e.change.effect.name in chosen.change.effect.contains and e.gain > SPECIAL * chosen.gain
    ]:
        chosen = max(inner, key=lambda each: each.gain)
    return chosen.change


def over_order(
    present: Fit, screening: Screening, *, boundaries: Sequence[int] = (), seed: int = 0, level: float = LEVEL
) -> OverOrder:
    """What changes over the order of recording beside a hypothesis, as it was found one effect after the other.

    Args:
        present: The hypothesis, whose tosses are in the order of recording.
        screening: The library beside it.
        boundaries: First tosses of sessions of the dataset, but for the first session.
        seed: Of the orders that are drawn.
        level: Of the first change; of further ones it is `LEVEL`.
    """
    changes, candidates = list[Change](), may_change(present, screening)
    first = now = _Segments((present.evidence,), (0, present.n), screening.columns, candidates)
    while enough(present.n) and now.candidates:
        effects = [each.where(now.columns) for each in now.candidates]
        p_values, places = change_p_values(effects, boundaries, seed)
        left = float(p_values.min())
        if left > (LEVEL if changes else level):
            return OverOrder(tuple(changes), left, None)
        change = _likeliest(now, p_values, places, boundaries, seed) if len(changes) < ROUNDS else None
        if change is None or (changes and change.gain < LEAST_SHARE * changes[0].gain):
            return OverOrder(tuple(changes), left, int(places[p_values.argmin()]))
        if len(changes) == 1 and change.gain > changes[0].gain:
            # what gains more beside another than that alone may explain it
            p_value, place = changes[0].p_value, change.stretches[-1].first
            n = len(first.candidates)
            whole = _likeliest(first, np.full(n, p_value), np.full(n, place), boundaries, seed, change.effect.name)
            if whole is not None and whole.gain > changes[0].gain:
                changes, now, change = [], first, whole
        changes.append(change)
        now = now.after(change, present)
    return OverOrder(tuple(changes), None, None)
