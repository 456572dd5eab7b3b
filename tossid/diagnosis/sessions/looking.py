"""Looking for effects that change over the order of recording, and undoing those of the recording."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.explain import begin
from tossid.diagnosis.localisation.gap import by_toss, deviance
from tossid.diagnosis.localisation.noise import Floor, noise_floor
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.sessions.changes import EffectOverOrder, changes_over_order, effect_over_order
from tossid.diagnosis.sessions.correction import corrected_tosses
from tossid.diagnosis.sessions.values import witnesses_of
from tossid.diagnosis.under_way import UnderWay
from tossid.motion.sessions.change_points import Change
from tossid.objects import ObjectModel
from tossid.physics.effects import Effect, World
from tossid.settings.diagnosis import DiagnoseSettings
from tossid.types import Toss

Array = NDArray[np.float64]
Make = Callable[[Sequence[Toss], ObjectModel], CrossValidator]
"""Makes the validator of tosses."""


@dataclass(frozen=True)
class Looked:
    """What was seen over the order beside a hypothesis.

    Attributes:
        validator: Of the tosses.
        present: The hypothesis.
        floor: The noise floor.
        changes: Where anything changes.
        effect: Whose change explains most; None if none does.
    """

    validator: CrossValidator
    present: Candidate
    floor: Floor
    changes: tuple[Change, ...]
    effect: EffectOverOrder | None

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
    def of(
        cls, tosses: Sequence[Toss], unseen: Sequence[Toss], names: Sequence[str], sessions: Sequence[str]
    ) -> TossOrder:
        """The order of tosses.

        Args:
            tosses: Diagnosed, in their order.
            unseen: Others of the same recording.
            names: Of all, in the order of recording.
            sessions: Names of the first tosses of sessions but for the first.
        """
        place = {name: i for i, name in enumerate(names)}
        ranks, others = (np.array([place[toss.name] for toss in some], dtype=int) for some in (tosses, unseen))
        starts = [place[name] for name in sessions]
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
        tosses = corrected_tosses(self.tosses, base, each.effect, each.values)
        unseen = corrected_tosses(self.unseen, base, each.effect, order.of_unseen(each.values))
        return Corrections(tosses, unseen, (*self.undone, (each, looked)))


def undo_changes(
    tosses: Corrections,
    world: World,
    library: Sequence[Effect],
    order: TossOrder,
    make: Make,
    settings: DiagnoseSettings,
    under_way: UnderWay | None = None,
) -> tuple[Looked, Looked, Corrections]:
    """Errors of the recording that change are undone one by one, largest first, beside the simulator as it is.

    Args:
        tosses: As recorded.
        world: The simulator.
        library: The effects that may change.
        order: Of the tosses.
        make: Makes their validator.
        settings: What is a change, and how many are undone at most.
        under_way: Told what is known.

    Returns:
        What was seen first and last, and the corrected tosses.
    """
    first: Looked | None = None
    while True:
        validator, present = begin(make(tosses.tosses, world.object), world, tosses.tosses, library, under_way)
        looked = look(validator, present, library, tosses.tosses, order, settings, undone=tosses.effects_undone)
        first = first or looked
        if not looked.correctable or len(tosses.undone) >= settings.order.rounds:
            return first, looked, tosses
        tosses = tosses.further(looked, order)


def look(
    validator: CrossValidator,
    present: Candidate,
    library: Sequence[Effect],
    tosses: Sequence[Toss],
    order: TossOrder,
    settings: DiagnoseSettings,
    *,
    undone: Collection[Effect] = (),
) -> Looked:
    """What changes over the order of tosses beside a hypothesis.

    Args:
        validator: Of the tosses.
        present: The hypothesis.
        library: The effects that may change.
        tosses: In their order.
        order: Where the dataset has sessions.
        settings: What is a change.
        undone: Effects for which the tosses are corrected. What is left of them is no other effect of their group.
    """
    floor = noise_floor(validator.windows)
    above = deviance(present.evidence, present.fitted.residuals) - floor.deviance
    rows = by_toss(present.evidence, present.evidence.windows.counted.astype(float), validator.n)
    excess = by_toss(present.evidence, above, validator.n) / np.maximum(rows, 1.0)
    places = np.array([toss.q[-1, :2] for toss in tosses])
    witnesses = witnesses_of(present, library, validator, places, excess)
    changes = changes_over_order(witnesses, settings.order)
    effect = None
    if changes:
        known = frozenset[str]().union(*({each.name} | each.one_of_group for each in undone))
        others = [each for each in library if each.name not in known]
        effect = effect_over_order(
            present, validator, others, witnesses, changes, settings.order, boundaries=order.boundaries
        )
    return Looked(validator, present, floor, changes, effect)
