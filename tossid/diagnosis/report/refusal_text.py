"""What effects do to whole tosses, in sentences, where they are refused for it."""

from __future__ import annotations

from tossid.diagnosis.localisation.refusal import Growth, RolloutCheck
from tossid.diagnosis.report.units import short


def refusal_words(check: RolloutCheck | None) -> str:
    """What a headline says after its verdict; empty if the whole is not refused.

    Args:
        check: What the effects do to whole tosses.
    """
    refused = check is not None and check.whole.refused
    return ", and what was found makes predictions of whole tosses worse" if refused else ""


def refusal_sentences(check: RolloutCheck | None) -> list[str]:
    """Which effects are refused, and by how much predictions of whole tosses get worse with them.

    Args:
        check: What the effects do to whole tosses.
    """
    if check is None or not check.refused:
        return []
    judges = f"{check.tosses} tosses that took no part in the fits"
    if check.whole.refused:
        return [
            f"Refused: with what was found, {judges} are predicted worse open loop than without. "
            f"{_grown(check.whole)} So it explains nothing, although it predicts short windows better, and its effects "
            "are candidates at most. Something that acts against them is missing, or they stand in for something else."
        ]
    return [
        f"Refused: {name}. With it, {judges} are predicted worse open loop than with the other effects alone. "
        f"{_grown(growth)} It is a candidate at most."
        for name, growth in check.effects
        if growth.refused
    ]


def _grown(growth: Growth) -> str:
    position, rotation = (
        f"error {'grows' if change > 0 else 'falls'} by {short(abs(change), 2)}"
        for change in (growth.position_pct, growth.rotation_deg)
    )
    return (
        f"At the median, the position {position} % of the width, and the rotation {rotation} deg "
        f"(p = {short(growth.p_value, 2)})."
    )
