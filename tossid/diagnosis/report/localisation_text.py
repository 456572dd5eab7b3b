"""Where the gap is, and the next toss, in sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from tossid.diagnosis.findings import Corner, Relation
from tossid.diagnosis.report.units import listed, percent, percent_span, place_of, short, span
from tossid.diagnosis.result import Diagnosis

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


_CARRIED = 0.25
"""Share of what remains, after impacts, that is worth a sentence."""


# ---------------------------------------------------------------- where the gap is


def carried_on(diagnosis: Diagnosis) -> str:
    """How much of what remains follows impacts, if it is much, with a space before it.

    Args:
        diagnosis: Of which something remains.
    """
    share = diagnosis.left.after_impacts.share.value
    if share < _CARRIED:
        return ""
    return (
        f" Of what remains, {percent(share)} lies in frames that follow an impact within the same short window: "
        "predictions carry on what they get wrong in an impact."
    )


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
    if diagnosis.found:
        parts.append((f"With {listed(diagnosis.found)}:", diagnosis.place.wrench_left))
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
        f"in this toss, and by {found['separation_of_tosses_seen_sd']:.1f} in a toss like those recorded, "
        "after the wrong one is fitted again.",
    ]
