"""Parts of a diagnosis in words, as the card, the page and the figures have them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from tossid.diagnosis.findings import Finding, Stretch
from tossid.diagnosis.report.units import in_units, listed, parameter, quantity, short, span, unit_of
from tossid.physics.effects import effect_named

PHASES = {
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


def estimates(finding: Finding) -> list[str]:
    """The parameters of an effect with their intervals; those that tosses do not determine in one item.

    Args:
        finding: What the tosses say of it.
    """
    known = {key: x for key, x in finding.parameters.items() if math.isfinite(x.value + x.high - x.low)}
    others = [parameter(key) for key in finding.parameters if key not in known]
    texts = [f"{parameter(key)} {in_units(key, x)}" for key, x in known.items()]
    return texts + ([f"{listed(others)} not determined"] if others else [])


def stated_words(effect: str, key: str, value: float) -> str:
    """A parameter as the simulator has it; empty where the value only stands for "no effect".

    Args:
        effect: Name of the effect.
        key: The parameter's name in the library.
        value: Its stated value [SI].
    """
    declared = next((p for p in effect_named(effect).parameters if p.name == key), None)
    stands_for_none = declared is not None and (declared.form or declared.nominal not in (None, 0.0, 1.0))
    return "" if stands_for_none else quantity(key, value)


def over_order_words(finding: Finding) -> str:
    """How an effect goes over the order of recording.

    Args:
        finding: With `over_order`.
    """
    order = finding.over_order
    assert order is not None
    about = f"p = {short(order.p_value, 2)}" + ("; the tosses were corrected for it" if order.undone else "")
    if order.form == "drift":
        rates = []
        for key, rate in order.rate.items():
            unit, factor = unit_of(key)
            rates.append(f"{parameter(key)} by {span(rate.scaled(100 * factor), unit)}")
        first, last = order.stretches[0].first, order.stretches[-1].last
        return f"{finding.name} drifts from toss {first} to {last}: {listed(rates)} per 100 tosses ({about})"
    parts = [f"{_values(finding.name, each)} in tosses {each.first} to {each.last}" for each in order.stretches]
    return f"{finding.name} changes: {'; '.join(parts)} ({about})"


def _values(name: str, stretch: Stretch) -> str:
    values = stretch.parameters
    if name == "world_tilt":  # the angle says more than its components
        return f"{math.degrees(math.hypot(*(value.value for value in values.values()))):.2f} deg"
    return listed([f"{parameter(key)} {in_units(key, value)}" for key, value in values.items()])


def wrench_words(component: str) -> str:
    """A component of the residual wrench in words; the path is that of the horizontal velocity.

    Args:
        component: Its name in gap.json.
    """
    return _WRENCH.get(component, component.replace("_", " ").replace("torque joint", "torque in joint"))


def state_words(state: str) -> tuple[str, str]:
    """A state on which a wrench may depend, in words, and its unit.

    Args:
        state: Its name in gap.json.
    """
    if state.startswith("joint_"):
        name = state.replace("_", " ")
        return (name.replace(" rate", "'s rate"), "rad/s") if state.endswith("_rate") else (f"{name}'s angle", "rad")
    return _STATES.get(state, (state, "1"))


def release_words(release: Mapping[str, Any]) -> str:
    """A release in a line.

    Args:
        release: gap.json's `next_toss.release`.
    """
    up = release["vertical_speed_ms"]
    return (
        f"the lowest corner {100 * release['lowest_corner_m']:.0f} cm above the ground, "
        f"{release['horizontal_speed_ms']:.2f} m/s sideways, {abs(up):.2f} m/s {'up' if up > 0 else 'down'}, "
        f"spin {release['spin_rads']:.1f} rad/s"
    )


def times_likelier(separation: float) -> str:
    """How much likelier the right one of two hypotheses becomes, on average: exp(s² / 2).

    Args:
        separation: s, their difference in standard deviations.
    """
    ratio = separation**2 / 2
    return "more than a million times" if ratio > math.log(1e6) else f"{short(math.exp(ratio), 2)} times"
