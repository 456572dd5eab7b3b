"""What tosses say by themselves against a hypothesis.

A hypothesis makes tosses from the same first states. What witnesses measure in these must be what they measure in the
recorded ones: a posterior predictive check. Where it is not, the search begins once more at what they measure, another
member of a class may lead, and what they contradict is no name.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.windows import Windows, make_windows
from tossid.diagnosis.localisation.rollouts import made_by, toss_errors
from tossid.diagnosis.localisation.witnesses import witnesses
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.search_result import SearchResult, replaced
from tossid.diagnosis.witness import Witness
from tossid.physics.effects import Effect, World
from tossid.types import Toss

Array = NDArray[np.float64]
Asked = Callable[[World], tuple[Witness, ...]]
"""What tosses say, given the world that was found."""

CONCERNS: dict[str, frozenset[str]] = {
    "inertia": frozenset({"inertia", "rounded_corners"}),
    "restitution": frozenset({"restitution", "compliance"}),
    "friction": frozenset({"friction", "velocity_friction", "anisotropic_friction", "cohesion", "adhesion"}),
}
"""The effects on which a witness of an effect bears."""


class PredictiveCheck(Protocol):
    """A posterior predictive check: what tosses say against a world."""

    def measured(self, found: World) -> dict[str, float]:
        """What they measure of effects, by name.

        Args:
            found: The world, whose recording errors, centre of mass and corners are used.
        """

    def contradicted(self, found: World) -> dict[str, float]:
        """What they measure of the effects whose values in a world they contradict, by name.

        Args:
            found: The world.
        """

    def errors(self, found: World) -> Array:
        """(n, 2) errors of a world's whole tosses: distance [% of the width] and angle [deg].

        Args:
            found: The world.
        """


@dataclass(frozen=True)
class CheckByTosses:
    """A posterior predictive check by witnesses and by whole tosses.

    Attributes:
        tosses: As recorded.
        stated: The world before the diagnosis.
        validator: With settings, and threads for the simulator.
    """

    tosses: Sequence[Toss]
    stated: World
    validator: CrossValidator

    def witnesses(self, found: World) -> tuple[Witness, ...]:
        """As of `ask_tosses`.

        Args:
            found: The world.
        """
        return ask_tosses(self.tosses, self.stated, found, self.validator)

    def measured(self, found: World) -> dict[str, float]:
        """As of `measured_values`.

        Args:
            found: The world.
        """
        return measured_values(self.witnesses(found))

    def contradicted(self, found: World) -> dict[str, float]:
        """As of `measured_values`, of the witnesses that contradict the world.

        Args:
            found: The world.
        """
        return measured_values([each for each in self.witnesses(found) if each.contradicts])

    def errors(self, found: World) -> Array:
        """As of `toss_errors`.

        Args:
            found: The world.
        """
        windows = _windows_of(self.tosses, found, self.validator)
        return toss_errors(self.tosses, found, windows, n_threads=self.validator.n_threads)


def ask_tosses(
    tosses: Sequence[Toss], stated: World, found: World, validator: CrossValidator, windows: Windows | None = None
) -> tuple[Witness, ...]:
    """What tosses say by themselves, beside what the found world's own tosses say.

    A user's simulator is not asked for whole tosses, and objects with joints have no witnesses.

    Args:
        tosses: As recorded.
        stated: The world before the diagnosis.
        found: The world after it.
        validator: With settings, and threads for the simulator.
        windows: Of these tosses, where they are at hand.
    """
    settings, made = validator.settings.witnesses, list[Toss]()
    if not (validator.engine.of_user or found.object.n_joints):
        windows = _windows_of(tosses, found, validator) if windows is None else windows
        made = made_by(tosses, found, windows, draws=settings.draws, n_threads=validator.n_threads)
    return witnesses(tosses, stated, found, settings, made)


def _windows_of(tosses: Sequence[Toss], found: World, validator: CrossValidator) -> Windows:
    """The tosses' windows, in the steps of whose settings a world is simulated."""
    return make_windows(tosses, found.object, settings=validator.settings.likelihood)


def measured_values(said: Sequence[Witness]) -> dict[str, float]:
    """What tosses say of effects, by the effect's name.

    Of several witnesses of an effect the one that most tosses reveal counts.

    Args:
        said: The witnesses of a hypothesis.
    """
    return {each.effect: each.measured.value for each in sorted(said, key=lambda each: each.tosses)}


def contradicted_names(said: Sequence[Witness], names: Collection[str]) -> frozenset[str]:
    """Those of some effects of a hypothesis that tosses contradict.

    Args:
        said: The witnesses of the hypothesis.
        names: Of the effects.
    """
    against = [CONCERNS[each.effect] for each in said if each.contradicts]
    return frozenset(names) & frozenset().union(*against)


def stand_ins(measured: Collection[str], effects: Sequence[Effect]) -> dict[str, str]:
    """Which effects of a hypothesis have the place of others that tosses measure, by name, and whose.

    An effect that contains the measured one is no stand-in, and there is none where a hypothesis has the measured one.

    Args:
        measured: Names of the effects that tosses measure.
        effects: Of the hypothesis.
    """
    there = {each.name for each in effects}.union(*(each.contains for each in effects))
    missing = [name for name in CONCERNS if name in measured and name not in there]
    return {each.name: name for each in effects for name in missing if each.name in CONCERNS[name]}


def decided_by_witnesses(found: SearchResult, validator: CrossValidator, asked: Asked) -> SearchResult:
    """The search's result with the member of each confusable class that tosses contradict least.

    The one that leads stays unless tosses contradict it in more than another. A class that free flight cannot
    distinguish is one there alone: another of its effects must not predict all held-out windows clearly worse.

    Args:
        found: What the search found.
        validator: Of all windows.
        asked: What tosses say.
    """

    def against(world: World) -> int:
        return sum(each.contradicts for each in asked(world))

    least = against(found.present.hypothesis.world()) if any(found.classes.values()) else 0
    for name, group in found.classes.items():
        present, fewest, chosen = found.present, least, None
        for each in group if least else ():
            if (count := against(replaced(present.hypothesis, name, each).world())) < fewest:
                fewest, chosen = count, each
        if chosen is not None:
            instead = validator.cross_validate(present, None, replaced(present.hypothesis, name, chosen))
            flown = name in present.hypothesis.names[: found.n_flight]
            if flown and validator.p_value_over(present, instead) < validator.settings.selection.class_level:
                continue
            needed = {**found.needed, chosen.name: chosen}
            others = tuple(each for each in (needed.pop(name), *group) if each is not chosen)
            classes = {other: each for other, each in found.classes.items() if other != name}
            found = replace(found.ending_in(instead), needed=needed, classes={**classes, chosen.name: others})
            least = against(instead.hypothesis.world())
    return found
