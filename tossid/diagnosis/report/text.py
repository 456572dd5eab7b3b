"""A diagnosis in sentences, the same on the console as on the page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from tossid.diagnosis.findings import Corner, Finding, Interval, Relation, Share
from tossid.diagnosis.report.units import (
    closed_share,
    in_units,
    listed,
    parameter,
    percent,
    percent_span,
    place_of,
    quantity,
    short,
    span,
)
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
_WRENCH = {
    "force_x": "force along x",
    "force_y": "force along y",
    "force_z": "force upwards",
    "force_along": "force along the path",
    "force_left": "force to the path's left",
    "torque_x": "torque about x",
    "torque_y": "torque about y",
    "torque_z": "torque about the vertical",
    "torque_spin": "torque along the spin",
    "torque_left": "torque rolling forward",
}
_STATES = {
    "time": ("time since release", "s"),
    "x": ("position x", "m"),
    "y": ("position y", "m"),
    "height": ("height", "m"),
    "lowest_corner": ("height of the lowest corner", "m"),
    "velocity_x": ("velocity along x", "m/s"),
    "velocity_y": ("velocity along y", "m/s"),
    "velocity_z": ("velocity upwards", "m/s"),
    "horizontal_speed": ("horizontal speed", "m/s"),
    "speed": ("speed", "m/s"),
    "spin": ("spin", "rad/s"),
    "spin_vertical": ("spin about the vertical", "rad/s"),
}
_VERDICTS = {
    "no_gap": "No gap beyond the measurement noise",
    "explained": "The gap is explained",
    "partly_explained": "The gap is partly explained",
    "unexplained": "The gap is not explained",
}
_MAIN_SHARE = 0.1
"""Share of the gap above which a phase or a channel is named in the first sentences."""


def headline(diagnosis: Diagnosis) -> str:
    """The verdict in one line.

    Args:
        diagnosis: What was found.

    Returns:
        The verdict, with the named effects.
    """
    line = _VERDICTS[diagnosis.verdict]
    return f"{line}: {listed(diagnosis.named)}" if diagnosis.named else line


def sentences(diagnosis: Diagnosis) -> list[str]:
    """The whole diagnosis in short paragraphs.

    Args:
        diagnosis: What was found.

    Returns:
        The paragraphs: how large the gap is and where, which effects explain it and with which values, how much of it
        they close, which effects cannot be distinguished, and what remains.
    """
    text = [_the_gap(diagnosis)]
    text += [_one_effect(diagnosis, name) for name in diagnosis.named]
    if diagnosis.named:
        text.append(_how_far(diagnosis))
        text += _confusable(diagnosis)
    text += [_another_law(name, power) for name, power in diagnosis.other_laws]
    text += [_unsteady(diagnosis, name) for name in diagnosis.unsteady]
    text.append(_what_remains(diagnosis))
    if diagnosis.gap.odd:
        tosses, their = ("toss", "its") if len(diagnosis.gap.odd) == 1 else ("tosses", "their")
        text.append(
            f"Inspect {tosses} {listed(diagnosis.gap.odd)}: {their} prediction errors are far larger than those of "
            "all other tosses."
        )
    return text


def _the_gap(diagnosis: Diagnosis) -> str:
    gap = diagnosis.gap
    text = (
        f"Over short windows, the simulator's prediction errors are {short(gap.total.value)} standard deviations of "
        f"the measurement noise (root mean square). Measurement noise alone would give {short(gap.noise_floor)}."
    )
    if diagnosis.verdict == "no_gap":
        return text + f" With {diagnosis.n_tosses} tosses, this is not a significant difference."
    by_phase = _largest("Most of the gap arises", gap.by_phase, _PHASES)
    return text + by_phase + _largest("It is largest in", gap.by_channel, CHANNELS)


def _largest(begin: str, shares: Sequence[Share], words: Mapping[str, str]) -> str:
    """The largest shares in a sentence: "Most of the gap arises at impacts (60 %) and while sliding (25 %)."."""
    order = sorted((s for s in shares if s.share.value > _MAIN_SHARE), key=lambda s: -s.share.value)[:2]
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
    return f"{text} Estimate with 95 % interval: {'; '.join(values)}." if values else text


def _estimate(key: str, value: Interval, stated: float | None) -> str:
    text = f"{parameter(key)} = {in_units(key, value)}"
    return text if stated is None else f"{text}, the simulator has {quantity(key, stated)}"


def _how_far(diagnosis: Diagnosis) -> str:
    closed = diagnosis.gap_closed
    together = "these effects" if len(diagnosis.named) > 1 else "this effect"
    text = (
        f"A simulator with {together} closes {closed_share(closed)} ({closed_share(closed, closed.low)} to "
        f"{closed_share(closed, closed.high)}) of the gap above the noise, measured on tosses that were not used for "
        "the fit."
    )
    if len(diagnosis.steps) > 1:
        (now, now_deg), (was, was_deg) = (
            (short(step.position_error_pct.value, 2), short(step.rotation_error_deg.value, 2))
            for step in (diagnosis.steps[-1], diagnosis.steps[0])
        )
        text += (
            " Predicted open loop over whole tosses, the position error is then "
            f"{now} % of the width instead of {was} %, and the rotation error {now_deg} deg instead of {was_deg} deg."
        )
    return text


def _confusable(diagnosis: Diagnosis) -> list[str]:
    named = [f for name in diagnosis.named for f in diagnosis.findings if f.name == name and f.confusable_with]
    return [
        f"These tosses cannot distinguish {finding.name} from {listed(finding.confusable_with, 'or')}: the cause may "
        'be any of them. See "The next toss" in the report.'
        for finding in named
    ]


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


def _what_remains(diagnosis: Diagnosis) -> str:
    if diagnosis.verdict == "no_gap":
        return (
            "No effect of the library is needed to explain the tosses. The table of all effects in the report lists "
            "the smallest size of each that these tosses would reveal."
        )
    left = f"{percent(max(0.0, 1.0 - diagnosis.gap_closed.value) if diagnosis.named else 1.0)} of the gap remains"
    if diagnosis.unexplained:
        where = [
            f"{_PHASES.get(share.name, share.name)} ({percent(share.share.value)} of the original gap)"
            for share in diagnosis.unexplained
        ]
        return f"{left}, a significant part of it {listed(where)}. The library has no effect that explains this part."
    if diagnosis.verdict == "explained":
        return f"{left}; no single phase of the motion holds a significant part of it."
    return f"{left}; no effect of the library explains it."


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
    return f"{text} with {listed(finding.confusable_with)}" if finding.confusable_with else text


# ---------------------------------------------------------------- where the gap is


def wrench_words(component: str) -> str:
    """A component of the residual wrench in words; the path is that of the horizontal velocity.

    Args:
        component: Its name in gap.json.

    Returns:
        The words.
    """
    return _WRENCH.get(component, component.replace("_", " ").replace("torque joint", "torque in joint"))


def state_words(state: str) -> tuple[str, str]:
    """A state on which a wrench may depend, in words, and its unit.

    Args:
        state: Its name in gap.json.

    Returns:
        The words and the unit.
    """
    if state.startswith("joint_"):
        name = state.replace("_", " ")
        return (name.replace(" rate", "'s rate"), "rad/s") if state.endswith("_rate") else (f"{name}'s angle", "rad")
    return _STATES.get(state, (state, "1"))


def wrench_sentences(relations: Sequence[Relation]) -> list[str]:
    """The residual wrenches of one hypothesis in words.

    Args:
        relations: What was found in each phase.

    Returns:
        A sentence or two for each phase.
    """
    text = []
    for r in relations:
        name, mean = wrench_words(r.component), r.means[r.component]
        kind, unit = ("force", "N") if r.component.startswith("force") else ("torque", "N m")
        share = percent(max(r.r2.value, 0.0))
        if r.state_clear:
            text.append(
                f"In {r.phase}, the simulator lacks a {name} that depends on the {state_words(r.state)[0]}. This "
                f"dependence explains {share} of the residual {kind}, whose mean is {span(mean, 2)} {unit}."
            )
        elif r.clear:
            text.append(
                f"In {r.phase}, the simulator lacks a {name} of {span(mean, 2)} {unit} on average. The mean explains "
                f"{share} of the residual {kind}; no dependence on a state explains more."
            )
        else:
            text.append(
                f"In {r.phase}, no residual force or torque is significant, neither on average nor as a function of a "
                f"state (the best candidate explains {share}, {percent(max(r.r2.low, 0.0))} to "
                f"{percent(max(r.r2.high, 0.0))}; p = {short(r.p_value, 2)})."
            )
    return text


def wrench_paragraphs(diagnosis: Diagnosis) -> list[str]:
    """The residual wrenches of the stated simulator, and of that with the named effects, in words.

    Args:
        diagnosis: What was found.

    Returns:
        A paragraph for each simulator.
    """
    parts = [("Before:", diagnosis.place.wrench)]
    if diagnosis.named:
        parts.append((f"With {listed(diagnosis.named)}:", diagnosis.place.wrench_left))
    return [" ".join([when, *wrench_sentences(found)]) for when, found in parts if found]


def corner_paragraphs(diagnosis: Diagnosis) -> list[str]:
    """The corner with the largest share of the gap per frame of contact, in words.

    Args:
        diagnosis: What was found.

    Returns:
        One paragraph; none if no corner touches.
    """
    touched = [c for c in diagnosis.place.corners if c.frames]
    if not touched:
        return []
    first: Corner = max(touched, key=lambda c: c.per_frame or 0.0)
    times = first.per_frame or 0.0
    text = (
        f"Per frame of contact, the gap is largest while the corner at {place_of(first.place)} touches: "
        f"{short(times, 2)} times the mean. This corner accounts for {percent_span(first.share)} of the gap in "
        f"contact, in {first.frames} frames."
    )
    if not times * first.share.low > first.share.value:
        text += " This is not significantly more than at the other corners."
    return [text]


# ---------------------------------------------------------------- the next toss


def next_toss_words(found: Mapping[str, Any]) -> list[str]:
    """The next toss in words.

    Args:
        found: gap.json's `next_toss`.

    Returns:
        What the toss is for, how to make it, and what it is expected to show; or one sentence why none is proposed.
    """
    release = found.get("release")
    if release is None:
        return [f"None proposed: {found.get('reason', 'nothing is confusable')}."]
    w, x, y, z = release["attitude_wxyz"]
    vx, vy, _ = release["velocity_ms"]
    heading = math.degrees(math.atan2(vy, vx))
    joints = [
        f"joint {k} at {at:.2f}, its rate {rate:.1f} per second (rad for a hinge, m for a slide);"
        for k, (at, rate) in enumerate(zip(release["joints"], release["joint_rates"], strict=True), start=1)
    ]
    return [
        f"To distinguish between {listed(found['between'])}, make this toss:",
        f"release with the lowest corner {100 * release['lowest_corner_m']:.0f} cm above the ground, at "
        f"x = {release['position_m'][0]:.2f} m, y = {release['position_m'][1]:.2f} m;",
        f"horizontal speed {release['horizontal_speed_ms']:.2f} m/s, {heading:.0f} degrees from the x axis; "
        f"{abs(release['vertical_speed_ms']):.2f} m/s {'up' if release['vertical_speed_ms'] > 0 else 'down'};",
        f"spin {release['spin_rads']:.1f} rad/s, ("
        + ", ".join(f"{s:.1f}" for s in release["spin_body_rads"])
        + ") about the body's axes;",
        *joints,
        f"orientation (quaternion w x y z) {w:.2f} {x:.2f} {y:.2f} {z:.2f}.",
        f"The two most similar explanations are expected to differ by {found['separation_sd']:.1f} standard deviations "
        f"in this toss, and by {found['separation_of_tosses_seen_sd']:.1f} in a toss like those recorded. Both "
        "numbers are upper bounds, because a refit of the effects reduces the difference.",
    ]
