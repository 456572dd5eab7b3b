"""Effects that change over the order of recording, in sentences."""

from __future__ import annotations

import math

from tossid.diagnosis.findings import Finding, Interval, Stretch
from tossid.diagnosis.report.units import in_units, listed, parameter, quantity, short, unit
from tossid.diagnosis.result import Diagnosis

_COUNTS = ("No", "One", "Two", "Three", "Four", "Five", "Six")


def over_order_sentences(diagnosis: Diagnosis) -> list[str]:
    """A sentence for each effect that is not the same in all tosses, and one on changes that none explains.

    Args:
        diagnosis: What was found.
    """
    changing = [finding for finding in diagnosis.findings if finding.over_order is not None]
    text = [_sentence(finding) for finding in changing]
    for change in diagnosis.changes_left or ():
        seen = ["the size of the gap" if name == "residual" else name for name in change.p_values]
        if not any(finding.name in change.p_values for finding in changing):
            text.append(
                f"Something changes from toss {change.before} on, in {listed(seen)} (p < "
                f"{max(change.p_values.values()):.2g}), which no effect of the library explains."
            )
    return text


def _sentence(finding: Finding) -> str:
    order = finding.over_order
    assert order is not None
    undone = " The tosses were corrected for it before other effects were sought." if order.undone else ""
    p = f" (p < {order.p_value:.2g})."
    if order.form == "drift":
        rates = [f"{parameter(key)} by {_per_hundred(key, rate)}" for key, rate in order.rate.items()]
        first, last = order.stretches[0].first, order.stretches[-1].last
        return f"{finding.name} drifts from toss {first} to {last}: {listed(rates)} per 100 tosses{p}{undone}"
    count = len(order.stretches)
    many = _COUNTS[count] if count < len(_COUNTS) else str(count)
    what = "recordings" if "recorded" in finding.says or order.undone else "stretches of tosses"
    parts = [f"tosses {stretch.first} to {stretch.last} {_in_words(finding, stretch)}" for stretch in order.stretches]
    return f"{many} {what}: {'; '.join(parts)}{p}{undone}"


def _in_words(finding: Finding, stretch: Stretch) -> str:
    values = stretch.parameters
    if finding.name == "world_tilt":
        tilt = math.degrees(math.hypot(*(value.value for value in values.values())))
        return f"stand in a world tilted by {tilt:.2f} degrees"
    if finding.name == "ground_height":
        return f"stand on a ground at {quantity('z_m', values['z_m'].value)}"
    return f"have {listed([f'{parameter(key)} = {in_units(key, value)}' for key, value in values.items()])}"


def _per_hundred(key: str, rate: Interval) -> str:
    name, factor = unit(key)
    value, low, high = (100 * factor * x for x in (rate.value, rate.low, rate.high))
    return f"{short(value)} {name}".rstrip() + f" ({short(low)} to {short(high)})"
