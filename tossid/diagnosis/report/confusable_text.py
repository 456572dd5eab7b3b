"""What tosses cannot tell apart, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

from tossid.diagnosis.findings import Finding
from tossid.diagnosis.report.units import listed
from tossid.diagnosis.result import Diagnosis

EARTH_MS2 = (9.764, 9.834)
"""Gravity's range on the Earth's surface [m/s²]. Hirt et al., Geophysical Research Letters 40 (2013)."""


def alone_instead(diagnosis: Diagnosis, finding: Finding) -> list[str]:
    """Names of effects each of which may be there instead of one, without those that only do the same together.

    Args:
        diagnosis: What was found.
        finding: Of the effect.
    """
    ours, theirs = diagnosis.exchanged
    return [name for name in finding.confusable_with if finding.name not in ours or name not in theirs]


def confusable_sentences(diagnosis: Diagnosis) -> list[str]:
    """Which effects could stand in for those that were found, and which other causes do the same in flight.

    Args:
        diagnosis: What was found.
    """
    ours, theirs = diagnosis.exchanged
    found = [each for each in diagnosis.findings if each.name in diagnosis.found]
    text = []
    for each in found:
        others = alone_instead(diagnosis, each)
        group = [one for one in diagnosis.findings if one.name in (each.name, *others)]
        if others:
            text.append(
                f"These tosses cannot distinguish {each.name} from {listed(others, 'or')}: the cause may be any of "
                f'them. See "The next toss" in the report.{_not_on_earth(group)}'
            )
    if any(each.name in ours for each in found):
        one, other = (f"{listed(names)} together" if len(names) > 1 else names[0] for names in (ours, theirs))
        text.append(
            f"In flight, {other} would do the same as {one}. Too much of the gap in contact is left to tell which of "
            'them is there. See "The next toss" in the report.'
        )
    return text


def _not_on_earth(group: Sequence[Finding]) -> str:
    """That gravity is not what differs, where the class has it with a value that no place on Earth has."""
    low, high = EARTH_MS2
    for finding in group:
        value = finding.parameters.get("g_ms2")
        if value is not None and (value.high < low or value.low > high):
            return f" Gravity is {low} to {high} m/s² everywhere on Earth, so it is not the cause in real tosses."
    return ""
