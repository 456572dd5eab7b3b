"""Cases of an audit in which an effect changes over the order of the tosses: once, all the while, or not at all.

The effect, the toss from which on it is there and the rate of a drift are withheld from the diagnosis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from tossid.objects import ObjectModel
from tossid.physics.effects import World, effect_named
from tossid.physics.effects.strength import Values
from tossid.settings.diagnosis.audit import ScoreSettings
from tossid.settings.synthesis import SynthesizeSettings
from tossid.synthesis.tosses import make_tosses
from tossid.types import Toss

STEP, DRIFT, NONE, CONSTANT, SHUFFLED = "step", "drift", "none", "constant", "shuffled"
"""What an effect does over the order. `NONE`: there is none; `CONSTANT`: all tosses have it; `SHUFFLED`: whatever real
tosses have, in an order that means nothing."""
NULLS = (NONE, CONSTANT, SHUFFLED)
"""Forms in which nothing changes."""
FORMS = (
    (STEP, ("world_tilt",)),
    (STEP, ("ground_height",)),
    (STEP, ("time_base",)),
    (STEP, ("world_tilt", "ground_height")),
    (STEP, ("friction",)),
    (DRIFT, ("time_base",)),
    (DRIFT, ("friction",)),
    (NONE, ()),
)
"""Forms of change and their effects, in turns: a table or camera that was tilted, raised, moved (both), a clock, a
surface that was cleaned; a clock and a surface that drift; and nothing."""
ENDS = 8
"""Tosses on each side of a change at least."""


@dataclass(frozen=True)
class OrderOfCase:
    """How a case's effects go over the order of its tosses.

    Attributes:
        form: What the effects do over the order.
        at: Number of the first toss that has the effects of a step whole.
    """

    form: str
    at: int = 0

    def share(self, toss: int, n: int) -> float:
        """How much of the effects a toss has, 0 to 1.

        Args:
            toss: Its number.
            n: How many there are.
        """
        if self.form in (STEP, CONSTANT):
            return float(toss >= self.at)
        return toss / (n - 1) if self.form == DRIFT else 0.0


def draw_order(turn: int, n_tosses: int, rng: np.random.Generator) -> tuple[OrderOfCase, tuple[str, ...]]:
    """The order of a case, and its effects.

    Args:
        turn: Number of the case.
        n_tosses: Tosses of a case.
        rng: What draws the moment.
    """
    form, effects = FORMS[turn % len(FORMS)]
    at = int(rng.integers(ENDS, n_tosses - ENDS + 1))
    return OrderOfCase(form, at if form == STEP else 0), effects


def tosses_over_order(
    effects: Mapping[str, Values],
    order: OrderOfCase,
    model: ObjectModel,
    synthesis: SynthesizeSettings,
    rng: np.random.Generator,
) -> tuple[Toss, ...]:
    """Tosses whose effects go over their order, otherwise as `make_tosses` makes them.

    Args:
        effects: Whole values, by effect and parameter.
        order: How they go.
        model: What is tossed.
        synthesis: How it is simulated.
        rng: What draws the releases.
    """
    n, made = synthesis.tosses, list[Toss]()
    shares = np.array([order.share(toss, n) for toss in range(n)])
    edges = [0, *(np.flatnonzero(np.diff(shares)) + 1).tolist(), n]
    for first, stop in pairwise(edges):
        own = values_at(effects, float(shares[first]), World(model, gravity=synthesis.gravity))
        some, _ = make_tosses(replace(synthesis, effects=own, tosses=stop - first), model, rng)
        made += some
    return tuple(replace(toss, name=f"{i:0{len(str(n - 1))}d}") for i, toss in enumerate(made))


def values_at(effects: Mapping[str, Values], share: float, world: World) -> dict[str, Values]:
    """Values of effects of which only a part is there.

    Args:
        effects: Whole values.
        share: 0 for none, 1 for all.
        world: The world without them.
    """
    out: dict[str, Values] = {}
    for name, values in effects.items() if share > 0 else ():
        effect = effect_named(name)
        nominal = effect.named(effect.nominal(world))
        out[name] = {key: nominal[key] + share * (value - nominal[key]) for key, value in values.items()}
    return out


def rates(effects: Mapping[str, Values], world: World, n_tosses: int) -> dict[str, Values]:
    """The change of each value of a drift from toss to toss.

    Args:
        effects: Whole values, which the last toss has.
        world: The world without them, which the first toss has.
        n_tosses: How many tosses there are.
    """
    out = {}
    for name, values in effects.items():
        nominal = effect_named(name).named(effect_named(name).nominal(world))
        out[name] = {key: (value - nominal[key]) / (n_tosses - 1) for key, value in values.items()}
    return out


def score_over_order(
    truth: Mapping[str, Any], gap: Mapping[str, Any], *, settings: ScoreSettings = ScoreSettings()
) -> dict[str, Any]:
    """What is right and wrong in what a diagnosis says of the order.

    Args:
        truth: `case` with its `order` and the number of tosses, and `effects`.
        gap: The content of gap.json.
        settings: What counts as right.

    Returns:
        `right`: all effects that change are named as such; of no change, that none is. `changing`: effects that are
        said to change; `further`: those of them that do not. `form_right`. `moment_right`: a change is within some
        tosses of the true one, whatever it is called. `rate`: the true and found change per toss of a drift. What does
        not apply is None.
    """
    form, at = truth["case"]["order"]["form"], truth["case"]["order"]["at"]
    true = dict(truth["effects"])
    changing = {f["name"]: f for f in gap["effects"] if "over_order" in f}
    left = [change["before"] for change in gap.get("changes_left") or []]
    starts = [s["first"] for f in changing.values() for s in f.get("sessions", [])[1:]] + left
    out: dict[str, Any] = {
        "form": form,
        "changing": {name: STEP if "sessions" in f else DRIFT for name, f in changing.items()},
        "further": sorted(set(changing) - set(true)),
        "form_right": None,
        "moment_right": None,
        "rate": None,
    }
    if form in NULLS:
        return {**out, "right": not changing and not left}
    found = set(true) & set(changing)
    out["form_right"] = bool(found) and all(out["changing"][name] == form for name in found)
    if form == STEP:
        out["moment_right"] = any(abs(int(start) - at) <= settings.same_moment for start in starts)
    elif found:
        name = min(found)
        (key,) = true[name]
        rate = changing[name].get("drift", {}).get("per_toss", {}).get(key)
        out["rate"] = None if rate is None else {"true": truth["rates"][name][key], **rate}
    return {**out, "right": found == set(true)}
