"""Effects that are not the same in all tosses: they step at a toss, or drift, over the order of recording.

Whether anything changes, and where, is tested in closed form (`designs`). Which effect changes is compared by
likelihood. Where a change is large, derivatives at one hypothesis are rough. So the likeliest few effects are fitted to
blocks of few tosses (`stretches`). Changes in these forms are compared beside constant values of each other's effects:
what is the same in all tosses shall count for none of them. What else changes is then sought beside a world of its own
for each stretch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.inference.columns import Columns, slopes, sums
from tossid.diagnosis.inference.designs import (
    FEWEST,
    LEVEL,
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
from tossid.diagnosis.inference.stretches import Blocks, Change, fitted_together
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


def _with(part: Evidence, effect: Effect, values: Array | None) -> Hypothesis:
    """The hypothesis of a part with values of an effect within their bounds; those that change nothing if None."""
    h = part.hypothesis.without(effect.name).plus(effect, values)
    return h.at(h.flat())


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

    def changed(self, change: Change, windows: Callable[[Sequence[int]], Windows] | None = None) -> _Beside:
        """With a change in each part's world, and the columns that there are without."""
        effect, name, parts = change.effect, change.effect.name, list[Evidence]()
        new = np.flatnonzero(np.any(np.diff(change.values, axis=0) != 0, axis=1)) + 1
        edges = tuple(sorted({*self.edges, *new.tolist()}))
        all_windows = None if windows is None else windows(edges)
        for a, b in pairwise(edges):
            part = self.part_of(a, b)
            h = replace(part.hypothesis.without(name), base=effect.at(part.hypothesis.base, change.values[a]))
            own = part.windows if all_windows is None else all_windows.of_tosses(np.arange(a, b))
            parts.append(collect(own, h, n_threads=part.n_threads))
        return replace(self, parts=tuple(parts), edges=edges)

    def after(self, change: Change, fitted: Fit, windows: Callable[[Sequence[int]], Windows] | None) -> _Beside:
        """With a change in each part's world. What is left of it is no effect that does the same."""
        name, there, sums_of = change.effect.name, self.changed(change, windows), list[Columns]()
        kept = tuple(s for s in self.suspects if not alike(change.effect, s.effect))
        owners = [owner for j, owner in enumerate(fitted.hypothesis.owners) if j in fitted.free]
        free = [owner for owner in owners if owner in self.parts[0].hypothesis.names and owner != name]
        for part, (a, b) in zip(there.parts, pairwise(there.edges), strict=True):
            J = np.zeros((*part.residuals.shape, self.columns.g.shape[1]))
            for each in dict.fromkeys(free):
                place = part.hypothesis.place_of(each)
                J[..., fitted.columns_of(each)] = slopes(part, part.hypothesis, range(place.start, place.stop))
            for s, start in ((each, start) for each in kept for start in each.starts if each.effect.name not in free):
                h = _with(part, s.effect, start.hypothesis.values_of(s.effect.name))
                place = h.place_of(s.effect.name)
                secant = (part.residuals_of(h) - part.residuals)[..., None] if start.secant else None
                J[..., start.columns] = slopes(part, h, range(place.start, place.stop)) if secant is None else secant
            sums_of.append(sums(part, J, b - a))
        return replace(there, columns=_joined(sums_of), suspects=kept)

    def gain_of_constant(self, change: Change) -> float:
        """What an effect that may change gains by values that all tosses have, fitted from the likeliest known ones."""

        def gain(parts: Sequence[Evidence]) -> float:
            return sum(float(log_likelihood_ratio(*two).sum()) for two in zip(parts, self.parts, strict=True))

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


def _locally(beside: _Beside, suspect: _Suspect, edges: Iterable[int]) -> Blocks:
    """An effect fitted to blocks of few tosses, none of which has an edge within, each from where its columns lead."""
    name, gain, made = suspect.effect.name, 0.0, list[Fit]()
    size = np.array([p.step for p in suspect.effect.parameters])
    for first, stop in pairwise(sorted({*beside.edges, *edges})):
        blocks = np.linspace(first, stop, max((stop - first) // FEWEST, 1) + 1).round().astype(int)
        for a, b in pairwise(blocks.tolist()):
            part, begun = beside.part_of(a, b), list[Hypothesis]()
            for start in suspect.starts:
                columns = beside.columns.part(start.columns).of_tosses(a, b)
                values, step = start.hypothesis.values_of(name), np.clip(columns.step(), -100, 100)
                begun.append(_with(part, suspect.effect, values if start.secant else values + step * size))
            if name in part.hypothesis.names:
                begun.append(part.hypothesis)
            if made:
                begun.append(_with(part, suspect.effect, made[-1].hypothesis.values_of(name)))
            near = max((_reached(part, h) for h in begun), key=lambda e: float(log_likelihood_ratio(e, part).sum()))
            held = frozenset(near.hypothesis.names) - {name}
            made.append(fit(near, near.hypothesis, n=b - a, iterations=ITERATIONS, held=held))
            gain += float(log_likelihood_ratio(made[-1].evidence, part).sum())
    return Blocks.of(suspect.effect, made, gain)


def _reached(part: Evidence, h: Hypothesis) -> Evidence:
    """The evidence of a hypothesis far away: from the recording, where the first states of the present one feel none.

    Objects that rest above the stated ground do not feel that it is somewhat higher.
    """
    near = part.relinearised(h, steps=2)
    return collect(part.windows, h, n_threads=part.n_threads) if np.array_equal(near.raw, part.raw) else near


@dataclass(frozen=True)
class _Made:
    """A change, what it gains and what a gain counts, and the tosses with it.

    A gain over the effect's own constant value lacks what that takes of the change, more for one effect than for
    another. A whole gain has what is the same in all tosses, for which only some effects account. So two changes are
    compared each beside a constant value of what the other one changes.
    """

    gain: float
    weight: float
    change: Change
    there: _Beside

    def weighed(self, constant: Change | None = None) -> float:
        """The weighed gain, beside a constant value of another effect if given."""
        return self.weight * (self.gain + (0.0 if constant is None else self.there.gain_of_constant(constant)))


def _likeliest(
    beside: _Beside, p_values: Array, places: Array, known: Sequence[int], seed: int, only: str = ""
) -> Change | None:
    """The effect whose change explains most; None if none does."""
    n, made = beside.columns.n, list[_Made]()

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
        edges = local.form(known, seed)
        if edges is not None and place not in edges:
            local = _locally(beside, suspect, edges)
            edges = local.form(known, seed)
        change = local.described(edges, float(p_values.min()), 0.0)
        there = beside.changed(change)
        ends = zip(there.parts, pairwise(there.edges), strict=True)
        gain = sum(float(log_likelihood_ratio(part, beside.part_of(a, b)).sum()) for part, (a, b) in ends)
        gain -= local.cost(edges, known)
        over_constant = gain - beside.gain_of_constant(change)
        if over_constant > LEAST_GAIN:
            made.append(_Made(gain, weight(suspect.effect), replace(change, gain=over_constant), there))

    tried = sorted(likely, key=lambda k: -gains[k])[:SUSPECTS]
    for k in tried:
        fit_in_form(k)
    if not made:
        return None
    best = max(made, key=_Made.weighed).change.effect
    near = best.one_of_group | best.made_of | {*best.contains}
    for k, suspect in enumerate(beside.suspects):
        if k not in tried and suspect.effect.name in near:
            fit_in_form(k)
    chosen, *others = sorted(made, key=_Made.weighed, reverse=True)
    for each in others:
        chosen = each if each.weighed(chosen.change) > chosen.weighed(each.change) else chosen
    while inner := [
        e for e in made if e.change.effect.name in chosen.change.effect.contains and e.gain > SPECIAL * chosen.gain
    ]:
        chosen = max(inner, key=lambda each: each.gain)
    return chosen.change


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
    columns_of = {name: np.asarray(present.columns_of(name), dtype=int) for name in h.names}
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
