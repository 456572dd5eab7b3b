"""Whether what was found makes predictions of whole tosses worse. What does is refused.

Effects are chosen by what they do to short windows. A whole toss can say otherwise: the right friction stops an object
too early, where the bounce that went with it is missing. So whole tosses that took no part in the fits are predicted
open loop, with what was found and without, each from the first states that its own forces give the recorded flight.

Contact turns small differences into large ones in a few tosses, so that means say little. What counts is in how many
tosses the error grows, and by how much at the median: Wilcoxon's signed ranks of the paired differences, against a
tolerance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.likelihood.windows import Windows
from tossid.diagnosis.localisation.rollouts import toss_errors
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.nested import JudgingFold
from tossid.diagnosis.selection.significance import part_p_value
from tossid.settings.diagnosis.diagnose import VerdictSettings
from tossid.types import Toss

Array = NDArray[np.float64]
_POINT = np.array([1.0, 0.5 * 100 * np.pi / 180])
"""How far distance [% of the width] and angle [deg] move a point half a width from the centre, at most."""
_LOST = 1e6
"""Error of a rollout that diverged [% of the width], [deg]: beyond any other."""


@dataclass(frozen=True)
class Growth:
    """How much the errors of whole tosses grow with some effects.

    Attributes:
        position_pct: Median over tosses [% of the width]; negative where they fall.
        rotation_deg: The same [deg].
        points_pct: The same of a point half a width from the centre [% of the width]: of distance and turn together.
        p_value: One-sided, that position or rotation grows by more than its tolerance (Bonferroni over both).
        level: Below which that is refused.
    """

    position_pct: float
    rotation_deg: float
    points_pct: float
    p_value: float
    level: float

    @staticmethod
    def of(errors: Array, before: Array, level: float, settings: VerdictSettings = VerdictSettings()) -> Growth:
        """The growth of paired errors.

        Args:
            errors: (n, 2) distance [% of the width] and angle [deg] of each toss with the effects; NaN if it diverged.
            before: (n, 2) without them.
            level: Of the test.
            settings: The tolerances.
        """
        grown = np.nan_to_num(errors, nan=_LOST) - np.nan_to_num(before, nan=_LOST)
        tolerance = np.array([settings.matters_position_pct, settings.matters_rotation_deg])
        position, rotation = np.median(grown, axis=0).tolist()
        points = float(np.median(grown @ _POINT))
        return Growth(position, rotation, points, part_p_value((grown - tolerance).T), level)

    @property
    def refused(self) -> bool:
        """Whether predictions are clearly worse: position or rotation, and not for a larger gain of the other."""
        return self.p_value < self.level and self.points_pct > 0

    def as_json(self) -> dict[str, Any]:
        """A part of gap.json's "rollouts"."""
        return {
            "position_pct": self.position_pct,
            "rotation_deg": self.rotation_deg,
            "points_pct": self.points_pct,
            "p_value": self.p_value,
            "refused": self.refused,
        }


@dataclass(frozen=True)
class RolloutCheck:
    """What effects do to the errors of whole tosses that took no part in the fits.

    Attributes:
        tosses: How many judge.
        unseen: How many of them no choice has seen either.
        whole: All effects, against none.
        effects: Each effect by name, against the others alone at the same values.
    """

    tosses: int
    unseen: int
    whole: Growth
    effects: tuple[tuple[str, Growth], ...] = ()

    @property
    def refused(self) -> tuple[str, ...]:
        """Names of the effects that are refused: all of them if they are worse than none."""
        return tuple(name for name, growth in self.effects if self.whole.refused or growth.refused)

    def as_json(self) -> dict[str, Any]:
        """gap.json's "rollouts"."""
        return {
            "n_tosses": self.tosses,
            "n_unseen": self.unseen,
            **self.whole.as_json(),
            "effects": [{"name": name, **growth.as_json()} for name, growth in self.effects],
        }


@dataclass(frozen=True)
class Refuted:
    """Effects without which the search was repeated, as they predict whole tosses worse than what tosses measure.

    Attributes:
        names: Of the effects.
        whole: What the hypothesis with them does to the errors of whole tosses, against that of the search without.
    """

    names: tuple[str, ...]
    whole: Growth

    def as_json(self) -> dict[str, Any]:
        """gap.json's "refuted"."""
        return {"effects": list(self.names), **self.whole.as_json()}


def check_rollouts(
    tosses: Sequence[Toss],
    unseen: Sequence[Toss],
    validator: CrossValidator,
    first: Hypothesis,
    last: Hypothesis,
    names: Sequence[str],
    folds: Sequence[JudgingFold],
    windows: Windows | None,
) -> RolloutCheck | None:
    """What the effects of a hypothesis do to whole tosses; None without effects.

    Unseen tosses judge. Where they are few, the searched tosses do too, each by its judging fold.

    Args:
        tosses: That were searched.
        unseen: That took no part.
        validator: Of the windows of those that were searched.
        first: The hypothesis without effects.
        last: With all effects.
        names: Of the effects that are judged one by one.
        folds: What was chosen and fitted without each part of the searched tosses.
        windows: Of the unseen tosses; None if there are none.
    """
    if not last.effects:
        return None
    settings = validator.settings.verdict
    judges = [(tuple(unseen), windows, last)] if windows is not None else []
    if len(unseen) < settings.fewest_judges:
        for fold in folds:
            some = np.flatnonzero(fold.held)
            own = tuple(tosses[i] for i in some.tolist())
            judges.append((own, validator.windows.of_tosses(some), fold.hypothesis))

    def errors(made: Callable[[Hypothesis], Hypothesis]) -> Array:
        """(n, 2) of all judging tosses, under what is made of the hypothesis that has not seen them."""
        rows = [
            toss_errors(some, made(theirs).world(), own, n_threads=validator.n_threads) for some, own, theirs in judges
        ]
        return np.concatenate(rows)

    def without(name: str) -> Array:
        return errors(lambda theirs: theirs.minus(name) if name in theirs.names else theirs)

    before, after = errors(lambda _: first), errors(lambda theirs: theirs)
    each_level = settings.refused_level / max(1, len(names))
    each = [(name, Growth.of(after, without(name), each_level, settings)) for name in names]
    whole = Growth.of(after, before, settings.refused_level, settings)
    return RolloutCheck(len(after), len(unseen), whole, tuple(each))
