"""A search where effects change over the order of recording.

The search takes every effect to be the same in all tosses. Whether anything is not is tested by what its rounds have
computed. Where something changes, it is sought beside the simulator as it is stated: what the search has found may
have been found for the change. Errors of the recording that change are undone, and the corrected tosses are searched
again. What cannot be undone is sought once more, beside what was found in them. What was undone is fitted once more
beside it, too: a change that was fitted beside nothing takes its share of what is the same in all tosses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis import findings as report
from tossid.diagnosis.correction import CORRECTABLE, corrected
from tossid.diagnosis.findings import ChangeLeft, Felt, Finding, ratio_over_tosses
from tossid.diagnosis.inference.brings import median_of
from tossid.diagnosis.inference.designs import LEVEL, Where, change_p_values, enough
from tossid.diagnosis.inference.evidence import Evidence, collect
from tossid.diagnosis.inference.fitting import fit
from tossid.diagnosis.inference.found import Found, Round
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.order import SHOWN, OverOrder, may_change, over_order, overlap
from tossid.diagnosis.inference.screening import screen
from tossid.diagnosis.inference.stretches import Change, fitted_together
from tossid.diagnosis.localisation.gap import rows_of
from tossid.diagnosis.localisation.noise import noise_floor
from tossid.diagnosis.localisation.rollouts import distances, first_states, whole_motions
from tossid.diagnosis.problem import Problem
from tossid.physics.effects import Effect, World
from tossid.physics.effects.effect import RecordingCorrection
from tossid.types import Toss

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ROUNDS = 4
"""Searches after a first one, at most, each of tosses that are corrected for more."""


@dataclass(frozen=True)
class Undone:
    """What a search has found in tosses that are corrected for what changes in their recording.

    Attributes:
        problem: With the corrected tosses and unseen tosses.
        found: By the search over these.
        changes: Of the recording, that were undone, the likeliest first.
        left: What changes beside what was found in the corrected tosses.
    """

    problem: Problem
    found: Found
    changes: tuple[Change, ...]
    left: OverOrder


def without_changes(problem: Problem, first: Evidence | None = None) -> Undone:
    """Search, undo errors of the recording that change, and search again.

    Args:
        problem: With the tosses in the order of recording.
        first: Evidence of the simulator as it is stated, if it is known.
    """
    recorded, found = problem, problem.search().run(first)
    changes, left, refitted_with = tuple[Change, ...](), OverOrder((), None, None), frozenset[str]()
    for _ in range(ROUNDS):
        names, changing = frozenset(found.hypothesis.names), {change.effect.name for change in changes}
        further = tuple[Change, ...]()
        if not names & changing:  # else the present values of what changes are not right yet
            left, further = _changes(problem, found, changes)
        if further:
            changes += further
        elif changes and names - refitted_with:
            changes = _refitted(recorded, found.hypothesis, changes)
            refitted_with |= names - changing
        else:
            break
        problem = _corrected(recorded, changes)
        found = problem.search().run()
    else:
        left = _changes(problem, found, changes)[0]
    return Undone(problem, found, changes, left)


def _refitted(recorded: Problem, h: Hypothesis, changes: tuple[Change, ...]) -> tuple[Change, ...]:
    """Changes beside what was found in tosses that were corrected for them, which has their effects no more."""

    def with_rest(change: Change) -> Change:
        """With what the corrected tosses still show of its effect, the same in all."""
        name = change.effect.name
        return change.shifted(h.values_of(name) - h.nominal_of(name)) if name in h.names else change

    return _fitted_together(recorded, h.without(*(c.effect.name for c in changes)), tuple(map(with_rest, changes)))


def _fitted_together(problem: Problem, h: Hypothesis, changes: tuple[Change, ...]) -> tuple[Change, ...]:
    """Changes that are fitted together; what they do to places of rest is no slow error of the tracker."""
    if not changes:
        return ()
    windows = problem.windows_of(problem.tosses, _corrected(problem, _correctable(changes)).tosses)
    return fitted_together(collect(windows, h, n_threads=problem.n_threads), changes)


def _changes(problem: Problem, found: Found, undone: Sequence[Change]) -> tuple[OverOrder, tuple[Change, ...]]:
    """What changes beside what was found, and what of it, or of what changes in the tosses as stated, can be undone."""
    if not enough(len(problem.tosses)):
        return OverOrder((), None, None), ()
    p_value = _p_value(found, problem)
    if p_value > LEVEL:
        return OverOrder((), p_value, None), ()
    h = found.hypothesis
    change = _changes_given(problem, h.without(*h.names), undone)
    if not _correctable(change.changes) and h.effects:
        change = _changes_given(problem, h, undone)
    if not change.changes and change.place is not None:
        change = replace(change, left=p_value)
    return change, _correctable(change.changes)


def _correctable(changes: Sequence[Change]) -> tuple[Change, ...]:
    return tuple(change for change in changes if change.effect.name in CORRECTABLE)


def _p_value(found: Found, problem: Problem) -> float:
    """That anything changes by chance, by the columns of the search's last rounds, of flight and of contact."""
    last = dict[bool, Round]()
    for each in found.rounds:
        last[bool(each.before.evidence.windows.free.all())] = each
    effects = list[list[Where]]()
    for each in last.values():
        effects += [one.where(each.screening.columns) for one in may_change(each.before, each.screening)]
    return float(change_p_values(effects, _boundaries(problem), problem.seed)[0].min())


def _changes_given(problem: Problem, h: Hypothesis, undone: Sequence[Change]) -> OverOrder:
    """What changes beside a hypothesis, all effects of which may. That anything does has been tested."""
    # what is left of a change that was undone is no change of another effect that does the same
    library = tuple(effect for effect in problem.library if not _is_undone(effect, undone))
    held = frozenset(effect.name for effect in h.effects if _is_undone(effect, undone))
    n, evidence = len(problem.tosses), problem.sample.evidence(h)
    present = fit(evidence, h, n=n, iterations=0, held=held)
    screening = screen(evidence, library, n=n, free=present.free, rng=np.random.default_rng(problem.seed))
    found = over_order(present, screening, boundaries=_boundaries(problem), seed=problem.seed, level=SHOWN)
    return replace(found, changes=_fitted_together(problem, h, found.changes))


def _is_undone(effect: Effect, changes: Sequence[Change]) -> bool:
    return any(overlap(change.effect, effect) for change in changes)


def _boundaries(problem: Problem) -> tuple[int, ...]:
    """Numbers of the tosses with which sessions of the dataset begin."""
    return tuple(np.searchsorted(_ranks(problem, problem.tosses), _places(problem, problem.sessions)).tolist())


def _ranks(problem: Problem, tosses: Sequence[Toss]) -> Index:
    """Where tosses stand in the order of the whole recording."""
    return _places(problem, [toss.name for toss in tosses])


def _places(problem: Problem, names: Sequence[str]) -> Index:
    place = {name: i for i, name in enumerate(problem.names)}
    return np.array([place[name] for name in names], dtype=int)


# ---------------------------------------------------------------- what is undone


def _corrected(recorded: Problem, changes: Sequence[Change]) -> Problem:
    """The problem without changes of the recording; an unseen toss has what the nearest one in the order has."""
    right = recorded.stated.base
    worlds = [_world(right, changes, i) for i in range(len(recorded.tosses))]
    away = _ranks(recorded, recorded.unseen)[:, None] - _ranks(recorded, recorded.tosses)
    nearest = np.abs(away).argmin(1) if len(away) else []

    def back(tosses: Sequence[Toss], wrong: Sequence[World]) -> tuple[Toss, ...]:
        return tuple(corrected(toss, own, right) for toss, own in zip(tosses, wrong, strict=True))

    return recorded.of(back(recorded.tosses, worlds), back(recorded.unseen, [worlds[i] for i in nearest]))


def _world(base: World, changes: Sequence[Change], toss: int, same: Change | None = None) -> World:
    """A world with what changes as it is in one toss, but for one change that is the same in all."""
    for change in changes:
        values = change.values.mean(0) if change is same else change.values[toss]
        base = change.effect.at(base, values)
    return base


def corrections(undone: Undone) -> dict[str, str]:
    """By effect of the recording that changes, how recorded data are corrected, as gap.json's "patch" has it.

    Args:
        undone: What was undone, and what else changes.
    """
    tosses, base, out = undone.problem.tosses, undone.problem.stated.base, {}
    for change in (*undone.changes, *undone.left.changes):
        effect, parts = change.effect, []
        if not isinstance(effect.mjcf, RecordingCorrection):
            continue
        for each in change.stretches:
            first, last = tosses[each.first].name, tosses[each.stop - 1].name
            some = f"toss {first}" if change.form == "drift" else f"tosses {first} to {last}"
            values = np.array([each.values[p.name].value for p in effect.parameters])
            parts.append(f"{some}: {effect.mjcf.text(effect.at(base, values))}")
        out[effect.name] = "; ".join(parts) + ("; between them along a line" if change.form == "drift" else "")
    return out


# ---------------------------------------------------------------- what is said of it


def changes_left(undone: Undone, recorded: Sequence[Toss]) -> tuple[ChangeLeft, ...] | None:
    """Where something changes that no effect explains; None where tosses are too few to show it.

    Args:
        undone: What was undone, and what else changes.
        recorded: The tosses in the order of recording.
    """
    if not enough(len(recorded)):
        return None
    place, p_value = undone.left.place, undone.left.left
    return () if place is None or p_value is None else (ChangeLeft(recorded[place].name, p_value),)


def findings_over_order(undone: Undone, recorded: Sequence[Toss]) -> tuple[Finding, ...]:
    """What is said of each effect that changes.

    Args:
        undone: What was undone, and what else changes.
        recorded: The tosses as they were recorded, in their order.
    """
    changes = (*undone.changes, *undone.left.changes)
    if not changes:
        return ()
    problem, n, threads = undone.problem, len(recorded), undone.problem.n_threads
    stated, width, h = problem.stated, problem.stated.base.object.width, undone.found.hypothesis
    windows = problem.windows_of(recorded, problem.tosses)
    floor, kept = noise_floor(windows), h.without(*(change.effect.name for change in changes))
    # tosses between which nothing changes are in one world
    values = np.concatenate([change.values for change in changes], axis=1)
    group = np.unique(values, axis=0, return_inverse=True)[1].ravel()
    groups = [np.flatnonzero(group == k) for k in range(group.max() + 1)]

    def found(numbers: Index, same: Change | None) -> Hypothesis:
        """What was found, in the world of some tosses, but for one change that is the same in all."""
        return replace(kept, base=_world(h.base, changes, int(numbers[0]), same))

    def excess(parts: Sequence[tuple[Hypothesis, Index]]) -> Array:
        """(n,) deviance of each toss above the noise floor, under a hypothesis for each part of the tosses."""
        there = [(collect(windows.of_tosses(i), h, n_threads=threads), i) for h, i in parts]
        rows = rows_of(there, floor)
        return rows.by_toss(rows.excess.mean(1))

    def felt(change: Change) -> Felt:
        """How a change moves whole tosses: its value in each against its mean, from the same first states."""
        apart = list[Array]()
        for numbers in groups:
            some, own = [recorded[i] for i in numbers.tolist()], windows.of_tosses(numbers)
            worlds = [found(numbers, same).world() for same in (None, change)]
            first = first_states(some, worlds[0], own, n_threads=threads)
            one, other = (whole_motions(some, world, first, own, threads) for world in worlds)
            apart.append(distances(one, other, width))
        return median_of(np.concatenate(apart))

    whole = excess([(stated, np.arange(n))])
    left = excess([(found(numbers, None), numbers) for numbers in groups])
    return tuple(
        Finding.of(
            change.effect,
            "identified",
            stated.world(),
            {"gain": change.gain, "p_value": change.p_value, "n_tosses": float(n)},
            parameters=change.mean(),
            gap_closed=ratio_over_tosses(excess([(found(each, change), each) for each in groups]) - left, whole),
            felt=felt(change),
            over_order=_in_words(change, recorded, undone=k < len(undone.changes)),
        )
        for k, change in enumerate(changes)
    )


def _in_words(change: Change, tosses: Sequence[Toss], *, undone: bool) -> report.OverOrder:
    stretches = tuple(
        report.Stretch(tosses[each.first].name, tosses[each.stop - 1].name, each.stop - each.first, each.values)
        for each in change.stretches
    )
    return report.OverOrder(change.form, stretches, change.rate, change.p_value, undone)
