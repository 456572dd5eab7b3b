"""What tosses cannot tell apart, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

from tossid.diagnosis.findings import Finding
from tossid.diagnosis.report.units import listed
from tossid.diagnosis.result import Diagnosis
from tossid.objects import ObjectModel
from tossid.objects.volume import hull_volume

AIR_KGPM3 = 1.2
"""Density of air at 20 degrees and sea level."""
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
                f'them. See "The next toss" in the report.{_of_gravity(group, diagnosis.hypothesis.base.object)}'
            )
    if any(each.name in ours for each in found):
        one, other = (f"{listed(names)} together" if len(names) > 1 else names[0] for names in (ours, theirs))
        text.append(
            f"In flight, {other} would do the same as {one}. Too much of the gap in contact is left to tell which of "
            'them is there. See "The next toss" in the report.'
        )
    return text


def _of_gravity(group: Sequence[Finding], model: ObjectModel) -> str:
    """Whether gravity can be what differs, where the class has it with a value that no place on Earth has.

    The air that an object displaces carries a part of its weight, so that a light one falls more slowly.
    """
    low, high = EARTH_MS2
    for finding in group:
        value = finding.parameters.get("g_ms2")
        if value is None or (value.high >= low and value.low <= high):
            continue
        carried = AIR_KGPM3 * hull_volume(model) / float(model.mass.sum())
        if low * (1 - carried) <= value.high < low:
            return (
                f" The air that the object displaces carries {100 * carried:.1f} % of its weight, which may be why "
                "gravity seems less."
            )
        return f" Gravity is {low} to {high} m/s² everywhere on Earth, so it is not the cause in real tosses."
    return ""
