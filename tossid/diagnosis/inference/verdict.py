"""Which verdict follows from what: one table for effects, one for the whole, and nothing changes a verdict afterwards.

An effect that a search has found:

| alike in its place | named in | tosses worse with it | its phases' gap closed | its force's law | verdict    |
|--------------------|----------|----------------------|------------------------|-----------------|------------|
|                    | < 90 %   |                      |                        |                 | candidate  |
|                    |          | yes                  |                        |                 | candidate  |
|                    |          |                      | < 50 %                 |                 | candidate  |
|                    |          |                      |                        | another         | candidate  |
| another effect     | >= 90 %  | no                   | >= 50 %                | holds           | confusable |
| none               | >= 90 %  | no                   | >= 50 %                | holds           | identified |

An effect that flight has determined is judged by the gap in flight, another by that in contact. What is left there and
is not clearly above noise counts as closed. Where something is left in contact, and the gap without effects is no
larger than what exact solvers of the same body disagree on, nothing of it counts as closed.

An effect that a search has not found is `not_supported` where these tosses would have shown it at a plausible size, and
`not_identifiable` where they would not. The first row that applies holds. Where no search was repeated, there is no
second column. Whether whole tosses feel an effect is no verdict: what they do not feel stands under "minor".

The whole gap:

| found      | gap over noise | whole tosses still feel          | gap closed | verdict                    |
|------------|----------------|----------------------------------|------------|----------------------------|
| nothing    | < 1.25         |                                  |            | no_gap                     |
| nothing    | >= 1.25        | no more than solvers disagree on |            | within_solver_disagreement |
| nothing    | >= 1.25        |                                  |            | unexplained                |
| a name     |                | nothing                          |            | explained                  |
| any effect |                | something                        | >= 50 %    | partly_explained           |
| any effect |                | something                        | < 50 %     | unexplained                |

Where all effects that are found are candidates, "nothing" in the third column counts as "something".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from tossid.diagnosis.findings import EffectVerdict, Interval

Verdict = Literal["no_gap", "explained", "partly_explained", "unexplained", "within_solver_disagreement"]

FREQUENT = 0.9
"""Share of resampled searches in which a name is sure."""
PARTLY = 0.5
"""Share of a gap from which it is explained in part."""
DETECTABLE = 4.0
"""Standard errors at which an effect would have been found."""
PLAUSIBLE = 0.5
"""Share of a parameter's range; what would be found only beyond is not identifiable."""
NO_GAP = 1.25
"""Gap over the noise floor below which there is none, if nothing is found."""


@dataclass(frozen=True)
class Facts:
    """What a verdict of a found effect follows from.

    Attributes:
        alike: Names of effects that may be there in its place.
        frequency: Share of resampled searches that name it, or one that is alike; None if none were made.
        worsens: Whether whole tosses that took no part are predicted worse with it.
        closes: Share of the gap that all effects close, in flight if flight has determined it, else in contact.
        holds: Whether its force, if it is one, grows with its state as its law says.
    """

    alike: tuple[str, ...]
    frequency: float | None
    worsens: bool
    closes: float
    holds: bool = True


def verdict_of_found(facts: Facts) -> EffectVerdict:
    """The verdict of an effect that a search has found, by the table above.

    Args:
        facts: Of the effect.
    """
    rare = facts.frequency is not None and facts.frequency < FREQUENT
    if rare or facts.worsens or facts.closes < PARTLY or not facts.holds:
        return "candidate"
    return "confusable" if facts.alike else "identified"


def verdict_of_others(detectable: Mapping[str, float], ranges: Mapping[str, float]) -> EffectVerdict:
    """The verdict of an effect that a search has not found.

    Args:
        detectable: Size of each parameter that these tosses would have shown; none where nothing moves.
        ranges: Of plausible values of each.
    """
    shown = any(size < PLAUSIBLE * ranges[name] for name, size in detectable.items())
    return "not_supported" if shown else "not_identifiable"


def verdict_of_gap(
    *, found: bool, sure: bool, gap_over_floor: float, felt: bool, closed: Interval, within_solvers: bool
) -> Verdict:
    """What is said of the whole gap, by the table above.

    Args:
        found: Whether any effect is there that whole tosses feel.
        sure: Whether one of these is more than a candidate.
        gap_over_floor: Root mean square of whitened residuals as stated, over that of noise.
        felt: Whether clearly more than half of the whole tosses still feel what is left.
        closed: Share of the gap that is closed on tosses that took no part.
        within_solvers: Whether what is left is no more than exact solvers of the same body disagree on.
    """
    if not found:
        if gap_over_floor < NO_GAP:
            return "no_gap"
        return "within_solver_disagreement" if within_solvers else "unexplained"
    if sure and not felt:
        return "explained"
    return "partly_explained" if closed.value >= PARTLY else "unexplained"
