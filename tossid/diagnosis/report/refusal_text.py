"""Why effects are refused, or candidates at most: what they do to whole tosses, and what tosses show against them."""

from __future__ import annotations

from tossid.diagnosis.localisation.contradictions import CONCERNS
from tossid.diagnosis.localisation.refusal import Growth, Refuted, RolloutCheck
from tossid.diagnosis.report.units import listed, short, span
from tossid.diagnosis.result import Diagnosis


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


def contradiction_sentences(diagnosis: Diagnosis) -> list[str]:
    """What tosses show by themselves against what was found, and what the search did without for that reason.

    Args:
        diagnosis: What was found.
    """
    text = _refuted(diagnosis.refuted)
    for each in diagnosis.witnesses:
        if not each.contradicts or each.predicted is None or diagnosis.verdict == "explained":
            continue
        concerned = [name for name in diagnosis.found if name in CONCERNS[each.effect]]
        said = (
            f"The {each.quantity} is {span(each.measured)} in {each.tosses} tosses, measured without a simulator. "
            f"Tosses that the simulator makes with what was found have {span(each.predicted)}. "
        )
        if concerned:
            text.append(f"{said}This contradicts {listed(concerned, 'or')}: a candidate at most.")
        else:
            text.append(f"{said}Nothing that was found accounts for it.")
    return text


def _refuted(refuted: Refuted | None) -> list[str]:
    """Which effects the search did without, although they predict short windows better."""
    if refuted is None:
        return []
    names = listed(refuted.names)
    return [
        f"The search was repeated without {names}: in its place, what tosses show without a simulator predicts whole "
        f"tosses better. The first answer, with {names}, does better over short windows, and worse over whole tosses. "
        f"{_grown(refuted.whole)}"
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
