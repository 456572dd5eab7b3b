"""The cases of an audit, drawn with a seed.

A case has one effect of the library in it, two, none, a force that the library does not have, or an effect that is then
taken out of the library. Its strength is such that the object is displaced by a drawn multiple of the position noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from tossid.audit.unknown_forces import UNKNOWN_FORCES
from tossid.physics.effects import Effect, all_effects, effect_named
from tossid.settings.audit import AuditSettings, CaseKind

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
        engine: What simulates it.
        effects: Names of the effects or forces in it.
        targets: Displacement by each of them, over the position noise.
        seed: Seed of all that is drawn for it.
    """

    index: int
    kind: CaseKind
    engine: str
    effects: tuple[str, ...]
    targets: tuple[float, ...]
    seed: int

    @property
    def without(self) -> tuple[str, ...]:
        """Effects that are removed from the library: the true one, all that contain it, all that together are it."""
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


def draw_cases(settings: AuditSettings, *, effects: Sequence[str], only_lcp: Sequence[str] = ()) -> tuple[Case, ...]:
    """The first cases of a seed; those of a smaller number are the first of them.

    Args:
        settings: How many, of which kinds and engines; targets are drawn log-uniformly.
        effects: Names of effects to draw from.
        only_lcp: Effects that only the engine lcp can simulate.
    """
    kinds, engines = settings.kinds, settings.engines
    rng = np.random.default_rng([settings.seed, 1])
    order = {kind: endless(list(effects), rng) for kind in ("effect", "without")}
    pairs, outside = endless(list(effects), rng), endless(list(UNKNOWN_FORCES), rng)
    several = {kind: endless(list(effects), rng) for kind in SEVERAL if kind in kinds}
    left: list[CaseKind] = []
    cases = []
    turn = dict.fromkeys(kinds, 0)
    for index in range(settings.cases):
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
        low, high = np.log(settings.displacement)
        targets = tuple(float(x) for x in np.exp(rng.uniform(low, high, len(names))))
        cases.append(Case(index, kind, engine, names, targets, int(rng.integers(2**32))))
    return tuple(cases)


def endless(names: list[str], rng: np.random.Generator) -> Iterator[str]:
    """All names in a drawn order, again and again.

    Args:
        names: The names.
        rng: Seeds the order when the first name is taken.
    """
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
