"""A diagnosis in sentences, the same on the console as on the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tossid.diagnosis.findings import Finding, Interval, Share
from tossid.diagnosis.report.confusable_text import alone_instead, confusable_sentences
from tossid.diagnosis.report.interruption_text import interruption_sentences
from tossid.diagnosis.report.limit_text import limit_sentences
from tossid.diagnosis.report.localisation_text import carried_on
from tossid.diagnosis.report.order_text import over_order_sentences
from tossid.diagnosis.report.refusal_text import contradiction_sentences, refusal_sentences, refusal_words
from tossid.diagnosis.report.units import closed_share, in_units, listed, parameter, percent, quantity, short
from tossid.diagnosis.result import Diagnosis
from tossid.physics.effects import effect_named

CHANNELS = {
    "p_x": "position along x",
    "p_y": "position along y",
    "p_z": "height",
    "r_x": "rotation about the body's x",
    "r_y": "rotation about the body's y",
    "r_z": "rotation about the body's z",
}
_PHASES = {
    "flight": "in flight",
    "impact": "at impacts",
    "slide": "while sliding",
    "roll": "while rolling or pivoting",
    "rest": "at rest",
}
_VERDICTS = {
    "no_gap": "No gap beyond the measurement noise",
    "explained": "The gap is explained",
    "partly_explained": "The gap is partly explained",
    "unexplained": "The gap is not explained",
    "within_solver_disagreement": "The gap is within what rigid-body solvers disagree on",
    "incomplete": "Interrupted before the gap was explained",
}
_IMPLAUSIBLE = {
    "at_bound": "Something acts like {name}, but its fit ends at the bound of what is physically possible, so it "
    "stands in for something else and is no name.",
    "no_change": "Something acts like {name}, but the interval of its values includes no change, so it is no name.",
}
_SATURATED = " More of it changes nothing in these tosses, so the interval ends where the plausible range does."


def headline(diagnosis: Diagnosis) -> str:
    """The verdict in one line.

    Args:
        diagnosis: What was found.

    Returns:
        The verdict, with the named effects.
    """
    line = _VERDICTS[diagnosis.verdict] + refusal_words(diagnosis.rollouts)
    named = listed([_with_frequency(diagnosis, name) for name in diagnosis.named])
    candidates = listed([_with_frequency(diagnosis, name) for name in diagnosis.candidates])
    if diagnosis.named:
        return f"{line}: {named}" + (f"; not sure: {candidates}" if candidates else "")
    if diagnosis.candidates:
        return f"{line}; not sure: {candidates}"
    needed = diagnosis.needed
    if needed is not None and not needed.enough and diagnosis.verdict != "no_gap":
        return f"{line}: {needed.tosses} tosses are too few to name every effect, {needed.contact} are needed"
    return line


def sentences(diagnosis: Diagnosis) -> list[str]:
    """The whole diagnosis in short paragraphs.

    Args:
        diagnosis: What was found.

    Returns:
        The paragraphs: how large the gap is and where, which effects explain it and with which values, how much of it
        they close, which effects cannot be distinguished, and what remains.
    """
    text = [
        *interruption_sentences(diagnosis),
        *_how_sure(diagnosis),
        _the_gap(diagnosis),
        *_too_few(diagnosis),
        *_not_repeated(diagnosis),
        *_in_plane(diagnosis),
    ]
    text += [_one_effect(diagnosis, name) for name in diagnosis.found]
    if diagnosis.found:
        text.append(_how_far(diagnosis))
        text += limit_sentences(diagnosis)
        text += confusable_sentences(diagnosis)
    text += [*refusal_sentences(diagnosis.rollouts), *contradiction_sentences(diagnosis)]
    text += [_another_law(name, power) for name, power in diagnosis.other_laws]
    text += [_unsteady(diagnosis, name) for name in diagnosis.unsteady]
    text += [_IMPLAUSIBLE[why].format(name=name) for name, why in diagnosis.implausible]
    text += over_order_sentences(diagnosis)
    text += _minor(diagnosis)
    text.append(_what_remains(diagnosis) + _misspecified(diagnosis))
    text += _learned(diagnosis)
    if diagnosis.gap.odd:
        tosses, their = ("toss", "its") if len(diagnosis.gap.odd) == 1 else ("tosses", "their")
        text.append(
            f"Inspect {tosses} {listed(diagnosis.gap.odd)}: {their} prediction errors are far larger than those of "
            "all other tosses."
        )
    return text


def _with_frequency(diagnosis: Diagnosis, name: str) -> str:
    """An effect, or its class, with how often repeated searches name it: "friction (10 of 10)"."""
    finding = next((each for each in diagnosis.findings if each.name == name), None)
    group = [name, *(finding.confusable_with if finding else ())]
    frequency, count = diagnosis.stability.frequency(group), len(diagnosis.stability.repeats)
    form = finding.over_order.form if finding and finding.over_order else None
    ours, theirs = diagnosis.exchanged
    alone = [name, *(alone_instead(diagnosis, finding) if finding else ())]
    stand_ins = [*alone, " with ".join(theirs)] if name in ours else alone
    text = listed(stand_ins, "or") + {"drift": ", which drifts", "steps": ", which changes"}.get(form or "", "")
    return text if frequency is None else f"{text} ({round(frequency * count)} of {count})"


def _how_sure(diagnosis: Diagnosis) -> list[str]:
    """How often repeated searches name what was found, and what they name besides."""
    count, none = len(diagnosis.stability.repeats), diagnosis.stability.probability_none
    found = diagnosis.found
    if none is None:
        return []
    text = f"The search was repeated {count} times, with resampled tosses and other windows. "
    if found:
        text += f"It named {listed([_with_frequency(diagnosis, name) for name in found])}. "
    known = {name for each in diagnosis.findings if each.name in found for name in (each.name, *each.confusable_with)}
    others = [
        f"{each.name} ({round(each.frequency * count)})"
        for each in sorted(diagnosis.findings, key=lambda each: -(each.frequency or 0.0))
        if each.frequency and each.name not in known
    ]
    if others:
        text += f"Other names in some repeats: {listed(others)}. "
    text += f"In {round(none * count)} of {count} no effect of the library explained the gap."
    if diagnosis.candidates:
        text += (
            f" Not sure, although significant: {listed(diagnosis.candidates)}. Repeated searches name such an effect "
            "too rarely, or most of the gap, or of its part in contact, stays with it, or whole tosses are predicted "
            "worse with it, or what tosses show without a simulator contradicts it."
        )
    return [text]


def _not_repeated(diagnosis: Diagnosis) -> list[str]:
    if diagnosis.stability.repeats or not diagnosis.found:
        return []
    return [f"How often {listed(diagnosis.found)} would be named again was not checked: no search was repeated."]


def _in_plane(diagnosis: Diagnosis) -> list[str]:
    """What a plane of motion cannot show."""
    plane = diagnosis.plane
    if plane is None:
        return []
    normal = ", ".join(short(x, 2) for x in plane.normal)
    whole = f" Not sought at all: {listed(plane.effects)}." if plane.effects else ""
    parts = [f"{parameter(name)} of {effect}" for effect, name in plane.hidden if effect not in plane.effects]
    return [
        f"All motion lies in one plane, with the normal ({normal}). What it cannot show is not fitted.{whole}"
        + (f" Left as stated: {listed(parts)}." if parts else "")
    ]


def _the_gap(diagnosis: Diagnosis) -> str:
    gap = diagnosis.gap
    text = (
        f"Over short windows, the simulator's prediction errors are {short(gap.total.value)} standard deviations of "
        f"the measurement noise (root mean square). Measurement noise alone would give {short(gap.noise_floor)}."
    )
    if diagnosis.verdict == "no_gap":
        return text + f" With {diagnosis.n_tosses} tosses, this is not a significant difference."
    noise = diagnosis.noise
    kinds = {} if noise is None else {"positions": noise.position, "rotations": noise.rotation}
    noisier = [
        f"{name} {short(x, 2)} times" for name, x in kinds.items() if x is not None and x > diagnosis.report.noisier
    ]
    if noisier:
        text += f" In flight, the poses have more noise than the dataset states ({listed(noisier)}); the floor has it."
    main = diagnosis.report.main_share
    by_phase = _largest("Most of the gap arises", gap.by_phase, _PHASES, main)
    return text + by_phase + _largest("It is largest in", gap.by_channel, CHANNELS, main)


def _learned(diagnosis: Diagnosis) -> list[str]:
    found = diagnosis.learned
    if found is None:
        return []
    size = f"The simulator has a learned acceleration k_res: {short(found.linear)} m/s²"
    size += (
        f" and {short(found.angular)} rad/s² in flight (root mean square)." if found.angular else " in flight (rms)."
    )
    if found.small:
        return [f"{size} That is next to nothing."]
    if not found.effects:
        return [f"{size} It does what no effect of the library does."]
    named = [f"{e.name} ({_values(e.parameters)}; {percent(e.share)} of its mean square)" for e in found.effects]
    rest = f" The rest, {percent(found.unexplained)}, has no name." if found.unexplained > _REST else ""
    return [
        f"{size} It stands for {listed(named)}. These forces are in the simulator already, as k_res, so the gap does "
        f"not show them.{rest}"
    ]


_REST = 0.005
"""Share of a learned acceleration that is worth a sentence."""


def _values(parameters: Mapping[str, float]) -> str:
    return ", ".join(f"{parameter(key)} {quantity(key, value)}" for key, value in parameters.items())


def _too_few(diagnosis: Diagnosis) -> list[str]:
    needed = diagnosis.needed
    if needed is None or needed.enough:
        return []
    why = (
        f"An effect that acts in contact can be named from {needed.contact} tosses on; there are {needed.tosses}. With "
        "fewer, even if all tosses agree, this could be chance, given the number of effects and tests."
    )
    flight = f" Effects of flight can be named from {needed.flight} tosses on whose flight is long enough" + (
        f"; there are {needed.flights}." if needed.flights < needed.flight else ", and were looked for."
    )
    return [why + flight]


def _largest(begin: str, shares: Sequence[Share], words: Mapping[str, str], least: float) -> str:
    """The largest shares in a sentence: "Most of the gap arises at impacts (60 %) and while sliding (25 %)."."""
    order = sorted((s for s in shares if s.share.value > least), key=lambda s: -s.share.value)[:2]
    if not order:
        return ""
    parts = [f"{words.get(s.name, s.name.replace('_', ' '))} ({percent(s.share.value)})" for s in order]
    return f" {begin} {listed(parts)}."


def _one_effect(diagnosis: Diagnosis, name: str) -> str:
    finding = next((f for f in diagnosis.findings if f.name == name), None)
    if finding is None:
        return f"{name}."
    stated = stated_values(diagnosis, name)
    values = [_estimate(key, value, stated.get(key)) for key, value in finding.parameters.items()]
    text = f"{name}: {finding.says}."
    if finding.over_order is not None:
        return f"{text} It is not the same in all tosses."
    text += f" Estimate with 95 % interval: {'; '.join(values)}." if values else ""
    return text + (_SATURATED if finding.saturated else "")


def _estimate(key: str, value: Interval, stated: float | None) -> str:
    text = f"{parameter(key)} = {in_units(key, value)}"
    return text if stated is None else f"{text}, the simulator has {quantity(key, stated)}"


def _how_far(diagnosis: Diagnosis) -> str:
    closed = diagnosis.gap_closed
    together = "these effects" if len(diagnosis.found) > 1 else "this effect"
    text = (
        f"A simulator with {together} closes {closed_share(closed)} ({closed_share(closed, closed.low)} to "
        f"{closed_share(closed, closed.high)}) of the gap above the noise, each toss predicted by what was chosen and "
        "fitted without it."
    )
    if (unseen := diagnosis.unseen) is not None:
        text += (
            f" On {unseen.tosses} tosses that took no part at all it closes {closed_share(unseen.closed)} "
            f"({closed_share(unseen.closed, unseen.closed.low)} to {closed_share(unseen.closed, unseen.closed.high)})."
        )
    # (what has no name is in later steps only)
    steps = [step for step in diagnosis.steps if set(step.effects) <= {*diagnosis.found, *diagnosis.minor}]
    if len(steps) > 1:
        (now, now_deg), (was, was_deg) = (
            (short(step.position_error_pct.value, 2), short(step.rotation_error_deg.value, 2))
            for step in (steps[-1], steps[0])
        )
        text += (
            " Predicted open loop over whole tosses, the position error is then "
            f"{now} % of the width instead of {was} %, and the rotation error {now_deg} deg instead of {was_deg} deg."
        )
    return text


def _another_law(name: str, power: Interval) -> str:
    law = effect_named(name).other_power_law
    assert law is not None
    return (
        f"In flight there is a force similar to {name}, but it follows another power law: its exponent in "
        f"{law.says} differs by {power.value:+.1f} ({power.low:+.1f} to {power.high:+.1f}) from that of "
        f"{name}. No effect of the library has this law."
    )


def _unsteady(diagnosis: Diagnosis, name: str) -> str:
    effect = next(e for e in diagnosis.hypothesis.effects if e.name == name)
    values = effect.named(diagnosis.hypothesis.values_of(name))
    size = ", ".join(f"{parameter(key)} {quantity(key, value)}" for key, value in values.items())
    return (
        f"In flight there is something similar to {name} (fitted to all tosses together: {size}), but it differs "
        "from toss to toss. No effect of the library does that."
    )


def _minor(diagnosis: Diagnosis) -> list[str]:
    """What was also seen, and is too small to matter."""
    parts = []
    for finding in diagnosis.findings:
        if finding.name in diagnosis.minor and finding.consequence is not None:
            values = ", ".join(f"{parameter(key)} {in_units(key, x)}" for key, x in finding.parameters.items())
            moves = f"{short(finding.consequence.position_pct, 2)} % of the width and "
            moves += f"{short(finding.consequence.rotation_deg, 2)} deg"
            parts.append(f"{finding.name} ({values}; it moves whole tosses by {moves})")
    return [f"Also seen, too small to matter: {listed(parts)}."] if parts else []


def _what_remains(diagnosis: Diagnosis) -> str:
    if diagnosis.verdict == "incomplete":
        return "What other effects would explain was not determined."
    if diagnosis.verdict == "no_gap":
        return (
            "No effect of the library is needed to explain the tosses. The table of all effects in the report lists "
            "the smallest size of each that these tosses would reveal."
        )
    other = diagnosis.disagreement
    if diagnosis.verdict == "within_solver_disagreement" and other is not None:
        return (
            "No effect of the library is needed to explain the tosses. Another exact solver of the same rigid body, "
            f"which resolves impacts of a time step at once, shows a gap of {short(other.gap)} standard deviations. In "
            f"95 % of the short windows with contact, its motions differ by up to {short(other.position_mm, 2)} mm and "
            f"{short(other.rotation_deg, 2)} deg."
        )
    left = f"{percent(max(0.0, 1.0 - diagnosis.gap_closed.value) if diagnosis.found else 1.0)} of the gap remains"
    if diagnosis.unexplained:
        where = [
            f"{_PHASES.get(share.name, share.name)} ({percent(share.share.value)} of the original gap)"
            for share in diagnosis.unexplained
        ]
        return (
            f"{left}, a significant part of it {listed(where)}.{carried_on(diagnosis)} The library has no effect that "
            "explains this part."
        )
    if diagnosis.verdict == "explained":
        return f"{left}; no single phase of the motion holds a significant part of it."
    return f"{left}; no effect of the library explains it."


def _misspecified(diagnosis: Diagnosis) -> str:
    own = diagnosis.misspecification
    if own is None or own.adds < diagnosis.report.misspecified:
        return ""
    return (
        f" The simulator that was found leaves {short(own.simulated_floor)} standard deviations of motions that it "
        f"made itself. So {short(own.adds, 2)} beyond noise may come from approximations of the diagnosis; no verdict "
        "counts them as explained."
    )


def stated_values(diagnosis: Diagnosis, name: str) -> dict[str, float]:
    """The parameters of a fitted effect as the simulator had them.

    Args:
        diagnosis: What was found.
        name: The effect's name.

    Returns:
        Values by parameter [SI]; none for a parameter whose nominal value only stands for "no effect".
    """
    effect = next((e for e in diagnosis.hypothesis.effects if e.name == name), None)
    if effect is None:
        return {}
    values = effect.nominal(diagnosis.hypothesis.base)
    # a nominal value that only stands for "none" would be read as a statement
    return {
        p.name: float(x)
        for p, x in zip(effect.parameters, values, strict=True)
        if p.nominal is None or p.nominal in (0.0, 1.0)
    }


def verdict_of(finding: Finding) -> str:
    """A finding's verdict in words.

    Args:
        finding: What the tosses say of one effect.

    Returns:
        The verdict, with the effects that it is confusable with.
    """
    text = finding.verdict.replace("_", " ")
    if finding.verdict == "candidate":
        return f"{text}, or {listed(finding.confusable_with, 'or')}" if finding.confusable_with else text
    return f"{text} with {listed(finding.confusable_with)}" if finding.confusable_with else text
