"""A diagnosis in words: what a person is told first, and the same in the console as on the page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from tossid.diagnosis.findings import Diagnosis, Finding, Interval, Relation, Share
from tossid.physics.effects import OTHER_LAWS

_UNITS = {
    "m": ("mm", 1e3),
    "rad": ("deg", 180 / math.pi),
    "rel": ("", 1.0),
    "ms2": ("m/s²", 1.0),
    "ms": ("m/s", 1.0),
    "n": ("N", 1.0),
    "npm": ("N/m", 1.0),
    "nspm": ("N s/m", 1.0),
    "ns2pm2": ("N s²/m²", 1.0),
    "ns2pm": ("N s²/m", 1.0),
    "nms": ("N m s", 1.0),
    "nm": ("N m", 1.0),
    "nmprad": ("N m/rad", 1.0),
    "ps": ("1/s", 1.0),
}
_CHANNELS = {
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
    "no_gap": "No gap to speak of",
    "explained": "The gap is explained",
    "partly_explained": "The gap is explained in part",
    "unexplained": "The gap is not explained",
}
_FINDINGS = {
    "identified": "identified",
    "confusable": "confusable",
    "not_supported": "not supported",
    "not_identifiable": "not identifiable",
}


def headline(diagnosis: Diagnosis) -> str:
    """The verdict in one line."""
    line = _VERDICTS[diagnosis.verdict]
    return f"{line}: {listed(diagnosis.named)}" if diagnosis.named else line


def sentences(diagnosis: Diagnosis) -> list[str]:
    """What the gap is, which effects explain it, what cannot be told apart, and what is left."""
    said = [_the_gap(diagnosis)]
    said += [_one_effect(diagnosis, name) for name in diagnosis.named]
    if diagnosis.named:
        said.append(_how_far(diagnosis))
        said += _not_told_apart(diagnosis)
    said += [_another_law(name, power) for name, power in diagnosis.other_laws]
    said += [_unsteady(diagnosis, name) for name in diagnosis.unsteady]
    said.append(_what_is_left(diagnosis))
    if diagnosis.gap.odd:
        s = "" if len(diagnosis.gap.odd) == 1 else "s"
        said.append(f"Look at toss{'es' if s else ''} {listed(diagnosis.gap.odd)}: far from all others.")
    return said


def _the_gap(diagnosis: Diagnosis) -> str:
    gap = diagnosis.gap
    text = (
        f"Over short windows the simulator misses the tosses by {short(gap.total.value)} standard deviations of the "
        f"measurement's noise, where noise alone would leave {short(gap.noise_floor)}."
    )
    if diagnosis.verdict == "no_gap":
        return text + f" On {diagnosis.n_tosses} tosses that is no difference."
    return text + _mostly("It misses mostly", gap.by_phase) + _mostly("It shows mostly in", gap.by_channel)


def _mostly(begin: str, shares: Sequence[Share]) -> str:
    """ " It misses mostly at impacts (60 %) and while sliding (25 %)." """
    order = sorted((s for s in shares if s.share.value > 0.1), key=lambda s: -s.share.value)[:2]
    if not order:
        return ""
    words = {**_PHASES, **_CHANNELS}
    parts = [f"{words.get(s.name, s.name.replace('_', ' '))} ({percent(s.share.value)})" for s in order]
    return f" {begin} {listed(parts)}."


def _one_effect(diagnosis: Diagnosis, name: str) -> str:
    finding = next((f for f in diagnosis.findings if f.name == name), None)
    if finding is None:
        return f"{name}."
    stated = stated_values(diagnosis, name)
    found = [_found(key, value, stated.get(key)) for key, value in finding.parameters.items()]
    return f"{name}: {finding.says}. Found: {'; '.join(found)}." if found else f"{name}: {finding.says}."


def _found(key: str, value: Interval, stated: float | None) -> str:
    text = f"{parameter(key)} = {in_units(key, value)}"
    return text if stated is None else f"{text}, the simulator has {quantity(key, stated)}"


def _how_far(diagnosis: Diagnosis) -> str:
    closed = diagnosis.gap_closed
    together = "them" if len(diagnosis.named) > 1 else "it"
    text = (
        f"With {together} in, {closes(closed)} ({closes(closed, closed.low)} to {closes(closed, closed.high)}) of what "
        "lies above the noise is closed, on tosses that took no part in the fit."
    )
    if len(diagnosis.steps) > 1:
        first, last = diagnosis.steps[0], diagnosis.steps[-1]
        now, was = (
            (short(step.position_error_pct.value, 2), short(step.rotation_error_deg.value, 2)) for step in (last, first)
        )
        text += (
            f" Whole tosses, predicted open loop from their flight, are then missed by {now[0]} % of the width and "
            f"{now[1]} deg; before it was {was[0]} % and {was[1]} deg."
        )
    return text


def _not_told_apart(diagnosis: Diagnosis) -> list[str]:
    said = []
    for name in diagnosis.named:
        finding = next((f for f in diagnosis.findings if f.name == name), None)
        if finding is not None and finding.confusable_with:
            others = listed(finding.confusable_with, "or")
            said.append(
                f"These tosses cannot tell {name} from {others}: it may be that instead. See the next toss below."
            )
    return said


def _another_law(name: str, power: Interval) -> str:
    grows, state = ("more" if power.value > 0 else "less"), OTHER_LAWS[name].says
    return (
        f"In flight there is a force like {name}, but it grows {grows} with {state}: by {power.value:+.1f} "
        f"({power.low:+.1f} to {power.high:+.1f}) in the power. No effect of the library has that law."
    )


def _unsteady(diagnosis: Diagnosis, name: str) -> str:
    effect = next(e for e in diagnosis.hypothesis.effects if e.name == name)
    values = effect.named(diagnosis.hypothesis.values_of(name))
    size = ", ".join(f"{parameter(key)} {quantity(key, value)}" for key, value in values.items())
    return (
        f"In flight there is something like {name} ({size} for all together), but not the same in all tosses, as no "
        "effect of the library is."
    )


def _what_is_left(diagnosis: Diagnosis) -> str:
    if diagnosis.verdict == "no_gap":
        return "No effect of the library is needed. The table below says what size of each would have shown."
    left = max(0.0, 1.0 - diagnosis.gap_closed.value) if diagnosis.named else 1.0
    if not diagnosis.unexplained:
        if diagnosis.verdict == "explained":
            return f"Left is {percent(left)}, and no phase in which it clearly gathers."
        return f"Left is {percent(left)}; no effect of the library explains it."
    where = [
        f"{_PHASES.get(share.name, share.name)} ({percent(share.share.value)} of the first gap)"
        for share in diagnosis.unexplained
    ]
    return f"Left is {percent(left)}, clearly so {listed(where)}: something there that the library has no name for."


def stated_values(diagnosis: Diagnosis, name: str) -> dict[str, float]:
    """The parameters of a fitted effect as the simulator had them."""
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


def listed(words: Sequence[str], last: str = "and") -> str:
    """ "a, b and c" """
    return ", ".join(words) if len(words) < 2 else f"{', '.join(words[:-1])} {last} {words[-1]}"


def percent(share: float) -> str:
    """A share in percent, with a proper minus."""
    return f"{100 * share:.0f} %".replace("-0 %", "0 %").replace("-", "−") if math.isfinite(share) else "unknown"


def closes(closed: Interval, value: float | None = None) -> str:
    """A closed share (or one end of its interval): beyond all of the gap is all of it."""
    return percent(min(closed.value if value is None else value, 1.0))


def short(value: float, digits: int = 3) -> str:
    """So many digits, no exponent for everyday sizes."""
    if not math.isfinite(value):
        return "unknown"
    if value == 0 or 1e-4 <= abs(value) < 1e6:
        decimals = max(0, digits - 1 - math.floor(math.log10(abs(value)))) if value else 0
        return f"{value:,.{decimals}f}".replace("-", "−").replace(",", "\u202f")
    return f"{value:.{digits - 1}e}".replace("-", "−")


def parameter(key: str) -> str:
    """A parameter's name without its unit: "x_m" is "x", "static_mu" is "static mu"."""
    head, _, tail = key.rpartition("_")
    return (head if head and tail in _UNITS else key).replace("_", " ")


def unit(key: str) -> tuple[str, float]:
    """Unit in which a parameter is shown, and the factor to it."""
    return _UNITS.get(key.rpartition("_")[2], ("", 1.0)) if "_" in key else ("", 1.0)


def quantity(key: str, value: float) -> str:
    """A value in its unit."""
    name, factor = unit(key)
    return f"{short(factor * value)} {name}".rstrip()


def change(key: str, size: float) -> str:
    """The size of a change in its unit; of relative parameters in percent."""
    name, factor = ("%", 100.0) if key.endswith("_rel") else unit(key)
    return f"{short(factor * size, 2)} {name}".rstrip()


def in_units(key: str, value: Interval) -> str:
    """ "0.299 (0.297 to 0.301)" """
    name, factor = unit(key)
    v, low, high = (factor * x for x in (value.value, value.low, value.high))
    digits = _decimals(v, high - low)
    texts = [f"{x:,.{digits}f}".replace("-", "−").replace(",", "\u202f") for x in (v, low, high)]
    return f"{texts[0]} {name}".rstrip() + f" ({texts[1]} to {texts[2]})"


def _decimals(value: float, width: float) -> int:
    """Decimals that two digits of an interval's width ask for."""
    size = width if width > 0 and math.isfinite(width) else abs(value)
    if not size > 0:
        return 0
    return int(min(max(0, 1 - math.floor(math.log10(size))), 8))


def verdict_of(finding: Finding) -> str:
    """A finding's verdict in words."""
    text = _FINDINGS[finding.verdict]
    return f"{text} with {listed(finding.confusable_with)}" if finding.confusable_with else text


def wrench_words(component: str) -> str:
    """A component of the residual wrench; the path is that of the horizontal velocity."""
    return _WRENCH.get(component, component.replace("_", " ").replace("torque joint", "torque in joint"))


def state_words(state: str) -> tuple[str, str]:
    """A state that a wrench may depend on, and its unit."""
    if state.startswith("joint_"):
        name = state.replace("_", " ")
        return (name.replace(" rate", "'s rate"), "rad/s") if state.endswith("_rate") else (f"{name}'s angle", "rad")
    return _STATES.get(state, (state, "1"))


def place_of(place: Sequence[float]) -> str:
    """A point on a body: "(+52, +52, −52) mm"."""
    return f"({', '.join(f'{1e3 * x:+.0f}' for x in place)}) mm".replace("-", "−").replace("+0,", "0,")


def where_words(relations: Sequence[Relation]) -> list[str]:
    """What the residual wrenches of one hypothesis say, a sentence a phase."""
    said = []
    for r in relations:
        name, mean = wrench_words(r.component), r.means[r.component]
        unit = "N" if r.component.startswith("force") else "N m"
        size = f"{short(mean.value, 2)} {unit} ({short(mean.low, 2)} to {short(mean.high, 2)}) on average"
        share = percent(max(r.r2.value, 0.0))
        if r.state_clear:
            said.append(
                f"In {r.phase} a {name} is missing that depends on the {state_words(r.state)[0]}: that explains "
                f"{share} of it. It is {size}."
            )
        elif r.clear:
            said.append(f"In {r.phase} a {name} is missing, {size}: that explains {share} of it, and no state more.")
        else:
            said.append(
                f"In {r.phase} no force or torque is clearly missing, on average or with any state "
                f"(the best explains {share}, {percent(max(r.r2.low, 0.0))} to {percent(max(r.r2.high, 0.0))}; "
                f"p = {short(r.p_value, 2)})."
            )
    return said


def next_toss_words(found: dict[str, Any]) -> list[str]:
    """The next toss in words."""
    release = found.get("release")
    if release is None:
        return [f"None proposed: {found.get('reason', 'nothing is confusable')}."]
    between = listed(found["between"])
    w, x, y, z = release["attitude_wxyz"]
    vx, vy, _ = release["velocity_ms"]
    heading = math.degrees(math.atan2(vy, vx))
    joints = [
        f"joint {k} at {at:.2f} and {rate:.1f} a second (rad, m);"
        for k, (at, rate) in enumerate(zip(release["joints"], release["joint_rates"], strict=True), start=1)
    ]
    return [
        f"To tell {between} apart, make this toss:",
        f"release with the lowest corner {100 * release['lowest_corner_m']:.0f} cm above the ground, at "
        f"x = {release['position_m'][0]:.2f} m, y = {release['position_m'][1]:.2f} m;",
        f"throw at {release['horizontal_speed_ms']:.2f} m/s towards {heading:.0f} degrees from x, "
        f"{abs(release['vertical_speed_ms']):.2f} m/s {'up' if release['vertical_speed_ms'] > 0 else 'down'};",
        f"spin it at {release['spin_rads']:.1f} rad/s, ("
        + ", ".join(f"{s:.1f}" for s in release["spin_body_rads"])
        + ") about its own axes;",
        *joints,
        f"attitude (quaternion w x y z) {w:.2f} {x:.2f} {y:.2f} {z:.2f}.",
        f"Expected: the two nearest explanations are {found['separation_sd']:.1f} standard deviations apart in this "
        f"toss; a toss like those seen gives {found['separation_of_tosses_seen_sd']:.1f}. (An upper bound: a refit "
        "takes some of it back.)",
    ]
