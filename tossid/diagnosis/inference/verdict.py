"""Which verdict follows from what: one table for effects, one for the whole, and nothing changes a verdict afterwards.

An effect that a search has found:

| whole tosses feel it | alike in its place | named in | tosses better with it | closes of its part | verdict    |
|----------------------|--------------------|----------|-----------------------|--------------------|------------|
| no                   |                    |          |                       |                    | minor      |
| yes                  |                    | < 90 %   |                       |                    | candidate  |
| yes                  |                    |          | no                    |                    | candidate  |
| yes                  |                    |          |                       | < 50 %             | candidate  |
| yes                  | another effect     | >= 90 %  | yes                   | >= 50 %            | confusable |
| yes                  | none               | >= 90 %  | yes                   | >= 50 %            | identified |

An effect that it has not found is `not_supported` where these tosses would have shown it at a plausible size, and
`not_identifiable` where they would not. The first row that applies holds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from tossid.diagnosis.findings import Interval

EffectVerdict = Literal["identified", "candidate", "confusable", "minor", "not_supported", "not_identifiable"]
Verdict = Literal["no_gap", "explained", "partly_explained", "unexplained", "within_solver_disagreement"]

FELT_PCT, FELT_DEG = 0.5, 0.5
"""Change of whole tosses from which a person would notice it [% of the width], [deg]: means over frames."""
FREQUENT = 0.9
"""Share of resampled searches in which a name is sure."""
PARTLY = 0.5
"""Share of a gap from which it is explained in part."""
DETECTABLE = 4.0
"""Standard errors at which an effect would have been found."""
PLAUSIBLE = 0.5
"""Share of a parameter's range; what would be found only beyond is not identifiable."""


@dataclass(frozen=True)
class Felt:
    """Differences of whole tosses, means over frames.

    Attributes:
        position_pct: Of the object's width.
        rotation_deg: Of its attitude.
    """

    position_pct: float
    rotation_deg: float

    def is_over(self, limit: Felt) -> bool:
        """Whether a person would notice it, or it exceeds what noise alone makes.

        Args:
            limit: What noise of the first states makes of the same tosses.
        """
        position, rotation = max(FELT_PCT, limit.position_pct), max(FELT_DEG, limit.rotation_deg)
        return self.position_pct > position or self.rotation_deg > rotation


NO_NOISE = Felt(0.0, 0.0)


@dataclass(frozen=True)
class Facts:
    """What a verdict of a found effect follows from.

    Attributes:
        felt: How whole tosses change without it.
        alike: Names of effects that may be there in its place.
        frequency: Share of resampled searches that name it, or one that is alike.
        improves: Whether whole tosses that took no part are predicted no worse with it.
        closes: Share of the gap in its phases that is closed by all effects together.
    """

    felt: Felt
    alike: tuple[str, ...]
    frequency: float
    improves: bool
    closes: float


def verdict_of_found(facts: Facts) -> EffectVerdict:
    """The verdict of an effect that a search has found, by the table above.

    Args:
        facts: Of the effect.
    """
    if not facts.felt.is_over(NO_NOISE):
        return "minor"
    if facts.frequency < FREQUENT or not facts.improves or facts.closes < PARTLY:
        return "candidate"
    return "confusable" if facts.alike else "identified"


def verdict_of_others(standard_errors: dict[str, float], ranges: dict[str, float]) -> EffectVerdict:
    """The verdict of an effect that a search has not found.

    Args:
        standard_errors: Of each parameter, as these tosses would determine it; infinite where nothing moves.
        ranges: Of plausible values of each.
    """
    shown = any(DETECTABLE * error < PLAUSIBLE * ranges[name] for name, error in standard_errors.items())
    return "not_supported" if shown else "not_identifiable"


def verdict_of_gap(
    *,
    found: bool,
    gap_over_floor: float,
    left: Felt,
    noise: Felt,
    closed: Interval,
    within_solvers: bool,
) -> Verdict:
    """What is said of the whole gap.

    Args:
        found: Whether any effect is there that whole tosses feel.
        gap_over_floor: Root mean square of whitened residuals as stated, over that of noise.
        left: How whole tosses that took no part differ from predictions with all effects.
        noise: What noise of the first states alone makes of such tosses.
        closed: Share of the gap that is closed on tosses that took no part.
        within_solvers: Whether what is left is no more than exact solvers of the same body disagree on.
    """
    if not found:
        if gap_over_floor < NO_GAP:
            return "no_gap"
        return "within_solver_disagreement" if within_solvers else "unexplained"
    if not left.is_over(noise):
        return "explained"
    return "partly_explained" if closed.value >= PARTLY else "unexplained"


NO_GAP = 1.25
"""Gap over the noise floor below which there is none, if nothing is found."""
