"""Looking for effects that change over the order of recording, and undoing those of the recording."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.localisation.gap import by_toss, deviance
from tossid.diagnosis.localisation.noise import Floor, noise_floor
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.selection.contact_law import with_contact_law
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.sessions.changes import changes_over_order, effect_over_order
from tossid.diagnosis.sessions.correction import corrected_tosses
from tossid.diagnosis.sessions.stretches import EffectOverOrder
from tossid.diagnosis.sessions.values import witnesses_of
from tossid.errors import InputError
from tossid.motion.sessions.change_points import Change
from tossid.physics.effects import Effect
from tossid.types import Toss

Array = NDArray[np.float64]
FEWEST_SHOWN, MOST_SHOWN = 4, 8
"""A third of the tosses is shown first, if that is at least so many, and at most so many. No result hangs on it."""


@dataclass(frozen=True)
class Looked:
    """What was seen over the order beside a hypothesis.

    Attributes:
        validator: Of the tosses.
        present: The hypothesis.
        floor: The noise floor.
        changes: Where anything changes.
        effect: Whose change explains most; None if none does.
        own_heights: Whether the tosses' heights were set one by one; the validator's then all end at one place.
    """

    validator: CrossValidator
    present: Candidate
    floor: Floor
    changes: tuple[Change, ...]
    effect: EffectOverOrder | None
    own_heights: bool = False

    @property
    def correctable(self) -> bool:
        """Whether an effect changes that can be undone."""
        return self.effect is not None and self.effect.correctable


@dataclass(frozen=True)
class TossOrder:
    """Where diagnosed and unseen tosses stand in the order of the whole recording.

    Attributes:
        ranks: Of the diagnosed tosses, (n,).
        unseen: Of the others.
        boundaries: Numbers of the diagnosed tosses with which sessions of the dataset begin.
    """

    ranks: NDArray[np.int64]
    unseen: NDArray[np.int64]
    boundaries: tuple[int, ...]

    @classmethod
    def of(cls, problem: Problem) -> TossOrder:
        """The order of a problem's tosses.

        Args:
            problem: With tosses in the order of their recording.
        """
        place = {name: i for i, name in enumerate(problem.names)}
        ranks, others = (
            np.array([place[toss.name] for toss in some], dtype=int) for some in (problem.tosses, problem.unseen)
        )
        starts = [place[name] for name in problem.sessions]
        return cls(ranks, others, tuple(int(np.searchsorted(ranks, start)) for start in starts))

    def of_unseen(self, values: Array) -> Array:
        """(m, P) values in unseen tosses, from those in the diagnosed ones before and after.

        Args:
            values: (n, P) in the diagnosed tosses.
        """
        return np.stack([np.interp(self.unseen, self.ranks, column) for column in values.T], axis=1)


@dataclass(frozen=True)
class Corrections:
    """Tosses without the errors of their recording that were found to change.

    Attributes:
        tosses: As they are now, in the order of recording.
        unseen: Others, likewise.
        undone: What was undone, each with what it was seen beside.
    """

    tosses: tuple[Toss, ...]
    unseen: tuple[Toss, ...] = ()
    undone: tuple[tuple[EffectOverOrder, Looked], ...] = ()

    @property
    def effects_undone(self) -> tuple[Effect, ...]:
        """The effects that were undone."""
        return tuple(each.effect for each, _ in self.undone)

    def further(self, looked: Looked, order: TossOrder) -> Corrections:
        """With what was seen undone too.

        Args:
            looked: With an effect that can be undone.
            order: Where unseen tosses stand.
        """
        each, base = looked.effect, looked.present.hypothesis.base
        assert each is not None
        how = partial(corrected_tosses, world=base, effect=each.effect, own_heights=looked.own_heights)
        tosses = how(self.tosses, values=each.values)
        unseen = how(self.unseen, values=order.of_unseen(each.values))
        return Corrections(tosses, unseen, (*self.undone, (each, looked)))


def undo_changes(problem: Problem) -> tuple[Looked, Looked, Corrections]:
    """Errors of the recording that change are undone one by one, largest first, beside the simulator as it is.

    Args:
        problem: With the tosses as recorded, in their order.

    Returns:
        What was seen first and last, and the corrected tosses.
    """
    tosses, order = Corrections(tuple(problem.tosses), tuple(problem.unseen)), TossOrder.of(problem)
    validator, base = with_contact_law(problem.validator(over_order=True), problem.world)
    present = validator.evaluate(Hypothesis(base))
    problem.under_way("the gap", 0.02)
    problem.under_way.begun(problem.tosses, validator, present)
    first = looked = look(validator, present, problem, order=order)
    while looked.correctable and len(tosses.undone) < problem.settings.order.rounds:
        tosses = tosses.further(looked, order)
        now = problem.of(tosses.tosses)
        # (what is wrong with a recording does not change the contact law)
        validator = replace(now.validator(over_order=True), engine=validator.engine)
        present = validator.evaluate(Hypothesis(base))
        looked = look(validator, present, now, order=order, undone=tosses.effects_undone)
    return first, looked, tosses


def tell_gap_of_first(problem: Problem) -> None:
    """Tell the gap of the first third of the tosses, at most of eight: it is known seconds before that of all.

    Args:
        problem: With the tosses in the order of their recording. Its `under_way` is told.
    """
    count = len(problem.tosses)
    shown = min(count // 3, MOST_SHOWN)
    if shown >= FEWEST_SHOWN:
        few = problem.of(problem.tosses[:shown])
        with suppress(InputError):  # these may be too short; of all, the whole search says it
            validator = few.validator(over_order=True)
            problem.under_way("the gap", 0.01)
            problem.under_way.begun(few.tosses, validator, validator.evaluate(Hypothesis(problem.world)), count)


def look(
    validator: CrossValidator,
    present: Candidate,
    problem: Problem,
    *,
    order: TossOrder,
    undone: Collection[Effect] = (),
) -> Looked:
    """What changes over the order of tosses beside a hypothesis.

    Args:
        validator: Of the tosses.
        present: The hypothesis.
        problem: With the tosses as they are now, in their order.
        order: Where the dataset has sessions.
        undone: Effects for which the tosses are corrected. What is left of them is no other effect of their group.
    """
    settings = problem.settings.order
    # (where all tosses end at one place, none says how a force depends on it)
    library = [each for each in problem.library if not (each.of_place and problem.own_heights)]
    floor = noise_floor(validator.windows)
    above = deviance(present.evidence, present.fitted.residuals) - floor.deviance
    rows = by_toss(present.evidence, present.evidence.windows.counted.astype(float), validator.n)
    excess = by_toss(present.evidence, above, validator.n) / np.maximum(rows, 1.0)
    places = np.array([toss.q[-1, :2] for toss in problem.tosses])
    witnesses = witnesses_of(present, library, validator, places, excess)
    changes = changes_over_order(witnesses, settings, boundaries=order.boundaries)
    effect = None
    if changes:
        known = frozenset[str]().union(*({each.name} | each.one_of_group for each in undone))
        others = [each for each in library if each.name not in known]
        effect = effect_over_order(
            present, validator, others, witnesses, changes, settings, boundaries=order.boundaries
        )
    return Looked(validator, present, floor, changes, effect, problem.own_heights)
