"""The cases of an audit, drawn with a seed.

A case has one effect of the library in it, two, none, a force that the library does not have, or an effect that is then
taken out of the library. Its strength is such that the object is displaced by a drawn multiple of the position noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from tossid.diagnosis.audit.over_order import CONSTANT, FORMS, NONE, OrderOfCase, draw_order
from tossid.diagnosis.audit.strengths import SPOILT
from tossid.diagnosis.audit.unknown_forces import UNKNOWN_FORCES
from tossid.physics.effects import Effect, all_effects, effect_named
from tossid.settings.diagnosis.audit import CaseKind

Kind = CaseKind | Literal["spoilt", "order"]

SEVERAL: dict[str, int] = {"four": 4, "eight": 8}
"""How many effects at once."""
OF_RECORDING = ("length_scale", "world_tilt")
"""Two errors of one recording: in flight they do what a constant force does."""
PAIRS = ("pair", "recording")
"""Kinds of cases with two effects, both of which must be named. Those of "pair" are of different families."""
OF_LIBRARY = ("effect", *PAIRS, *SEVERAL)
"""Kinds of cases whose effects are in the library."""
_NOT_BOTH = ("restitution", "compliance")
"""Contact rebounds by a coefficient or yields: the later one takes the earlier one's place."""

_WITH_ANOTHER_SIZE = frozenset({"gravity", "time_base", "length_scale"})
"""Each does nearly what another does beside an object of another size: recorded lengths that are too long are a larger
gravity and a larger object."""


@dataclass(frozen=True)
class Case:
    """What a case is, but for the strengths of its effects, which `strength_reaching` finds.

    Attributes:
        index: Its place in the audit.
        kind: What is in it.
        engine: What simulates it; "real" for real tosses.
        effects: Names of the effects or forces in it.
        targets: Displacement by each of them, over the position noise.
        seed: Seed of all that is drawn for it.
        order: How its effects go over the order of its tosses; None: they are in all of them.
    """

    index: int
    kind: Kind
    engine: str
    effects: tuple[str, ...]
    targets: tuple[float, ...]
    seed: int
    order: OrderOfCase | None = None

    @property
    def without(self) -> tuple[str, ...]:
        """Effects that are removed from the library.

        Returns:
            The true effect, all that contain it, and those that together are the same.
        """
        if self.kind != "without":
            return ()
        true = frozenset(self.effects).union(*(effect_named(name).made_of for name in self.effects))
        out = {e.name for e in all_effects() if e.name in true or true & set(e.contains)}
        out = out.union(*(effect_named(name).one_of_group for name in true))
        if true & _WITH_ANOTHER_SIZE:
            out |= _WITH_ANOTHER_SIZE | {e.name for e in all_effects() if _WITH_ANOTHER_SIZE & set(e.contains)}
        return tuple(e.name for e in all_effects() if e.name in out)

    def as_json(self) -> dict[str, Any]:
        """The case as plain values, for JSON."""
        return {**asdict(self), "effects": list(self.effects), "targets": list(self.targets)}


def draw_cases(
    n: int,
    *,
    seed: int,
    engines: Sequence[str],
    displacement: tuple[float, float],
    effects: Sequence[str],
    kinds: Sequence[CaseKind],
    only_lcp: Sequence[str] = (),
) -> tuple[Case, ...]:
    """The first cases of a seed; those of a smaller number are the first of them.

    Args:
        n: How many.
        seed: Seed of the draws.
        engines: Engines that take turns.
        displacement: Least and largest target, over the position noise; drawn log-uniformly between them.
        effects: Names of effects to draw from.
        kinds: What is in cases: every so many are these, in a drawn order.
        only_lcp: Effects that only the engine lcp can simulate.

    Returns:
        The cases.
    """
    rng = np.random.default_rng([seed, 1])
    order = {kind: _endless(list(effects), rng) for kind in ("effect", "without")}
    pairs, outside = _endless(list(effects), rng), _endless(list(UNKNOWN_FORCES), rng)
    several = {kind: _endless(list(effects), rng) for kind in SEVERAL if kind in kinds}
    left: list[CaseKind] = []
    cases = []
    turn = dict.fromkeys(kinds, 0)
    for index in range(n):
        if not left:
            left = [kinds[i] for i in rng.permutation(len(kinds))]
        kind = left.pop()
        names: tuple[str, ...] = ()
        if kind in order:
            names = (next(order[kind]),)
        elif kind == "pair":
            names = _pair(pairs)
        elif kind == "recording":
            names = OF_RECORDING
        elif kind in several:
            names = _together(several[kind], SEVERAL[kind])
        elif kind == "outside":
            names = (next(outside),)
        engine = engines[turn[kind] % len(engines)]
        turn[kind] += 1
        if kind == "outside" or ("lcp" in engines and set(names) & set(only_lcp)):
            engine = "lcp"
        low, high = np.log(displacement)
        targets = tuple(float(x) for x in np.exp(rng.uniform(low, high, len(names))))
        cases.append(Case(index, kind, engine, names, targets, int(rng.integers(2**32))))
    return tuple(cases)


def draw_spoilt(n: int, *, seed: int) -> tuple[Case, ...]:
    """The first cases of spoilt simulators on real tosses.

    Args:
        n: How many.
        seed: Seed of the draws.

    Returns:
        The cases.
    """
    rng = np.random.default_rng([seed, 2])
    names = _endless(list(SPOILT), rng)
    return tuple(Case(i, "spoilt", "real", (next(names),), (), int(rng.integers(2**32))) for i in range(n))


def draw_over_order(
    n: int, *, seed: int, engines: Sequence[str], displacement: tuple[float, float], tosses: int
) -> tuple[Case, ...]:
    """The first cases of effects that change over the order of their tosses.

    Args:
        n: How many.
        seed: Seed of the draws.
        engines: Engines that take turns.
        displacement: As of `draw_cases`.
        tosses: Tosses of a case.

    Returns:
        The cases.
    """
    rng, (low, high) = np.random.default_rng([seed, 6]), np.log(displacement)
    cases = []
    for i in range(n):
        order, names = draw_order(i, tosses, rng)
        targets = tuple(float(x) for x in np.exp(rng.uniform(low, high, len(names))))
        engine = engines[(i + i // len(FORMS)) % len(engines)]
        cases.append(Case(i, "order", engine, names, targets, int(rng.integers(2**32)), order))
    return tuple(cases)


def draw_nulls(
    n: int, *, seed: int, engines: Sequence[str], displacement: tuple[float, float], effects: Sequence[str]
) -> tuple[Case, ...]:
    """The first cases in which nothing changes over the order: in turns, no effect, and one that all tosses have.

    Args:
        n: How many.
        seed: Seed of the draws.
        engines: Engines that take turns.
        displacement: As of `draw_cases`.
        effects: Names of effects to draw from, which all engines can simulate.

    Returns:
        The cases.
    """
    rng, (low, high) = np.random.default_rng([seed, 7]), np.log(displacement)
    drawn, cases = _endless(list(effects), rng), []
    for i in range(n):
        names = (next(drawn),) if i % 2 else ()
        targets = tuple(float(x) for x in np.exp(rng.uniform(low, high, len(names))))
        order, engine = OrderOfCase(CONSTANT if names else NONE), engines[i // 2 % len(engines)]
        cases.append(Case(i, "order", engine, names, targets, int(rng.integers(2**32)), order))
    return tuple(cases)


def _endless(names: list[str], rng: np.random.Generator) -> Iterator[str]:
    """All names in a drawn order, again and again. The order does not depend on when they are taken."""
    own = np.random.default_rng(rng.integers(2**32))
    while True:
        yield from (names[i] for i in own.permutation(len(names)))


def _pair(names: Iterator[str]) -> tuple[str, str]:
    """Two effects of different families that are not one."""
    first = next(names)
    while True:
        second = next(names)
        one, other = effect_named(first), effect_named(second)
        if one.family != other.family and not _are_one(one, other):
            return first, second


def _together(names: Iterator[str], count: int) -> tuple[str, ...]:
    """Some effects of which no two are one."""
    chosen: list[Effect] = []
    while len(chosen) < count:
        effect = effect_named(next(names))
        if not any(_are_one(effect, other) for other in chosen):
            chosen.append(effect)
    return tuple(effect.name for effect in chosen)


def _are_one(one: Effect, other: Effect) -> bool:
    """Whether two effects together do no more than one of them or a third, so that no toss could tell both.

    Among these are effects of which one contains what the other is made of. In rigid contact, which has no time scale,
    a clock of another rate is more gravity. Beside a constant force, which contains gravity, it is another constant
    force.
    """
    if one.name == other.name or {one.name, other.name} == set(_NOT_BOTH) or other.name in one.one_of_group:
        return True
    has, others = ({each.name, *each.contains} for each in (one, other))
    return other.name in has or one.name in others or bool(one.made_of & others) or bool(other.made_of & has)
