"""Tosses in which an effect changes over the order of recording: once, all the while, or not at all.

The effect, the toss from which on it is there and the rate of a drift are drawn, as those of an audit's cases are.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from tossid.audit.cases import Case, endless
from tossid.audit.making import TOSSES, record, strengths_of, synthesis_of
from tossid.audit.run import only_in_lcp
from tossid.audit.strengths import strengths_for
from tossid.objects import ObjectModel, load_object
from tossid.physics.effects import World, effect_named
from tossid.physics.effects.strength import Values
from tossid.settings.audit import AuditSettings
from tossid.settings.diagnosis.likelihood import WindowSettings
from tossid.settings.synthesis import SynthesizeSettings
from tossid.store import read_dataset
from tossid.synthesis.tosses import make_tosses
from tossid.types import Toss

Tosses = tuple[tuple[Toss, ...], ObjectModel, dict[str, Any]]
"""Tosses in the order of recording, their stated object, and the truth of what changes."""

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
SAME_MOMENT = 3
"""Tosses by which a change may be found off."""


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


@dataclass(frozen=True)
class OrderCase:
    """A case, and how its effects go over the order of its tosses.

    Attributes:
        case: Of which engine, with which effects.
        order: How these go.
    """

    case: Case
    order: OrderOfCase


def draw_changes(n: int, settings: AuditSettings) -> list[OrderCase]:
    """The first cases of effects that change over the order of their tosses; in one of eight, nothing does.

    Args:
        n: How many.
        settings: Seed, engines, displacements and number of tosses.
    """
    rng, (low, high) = np.random.default_rng([settings.seed, 6]), np.log(settings.displacement)
    cases = []
    for i in range(n):
        form, names = FORMS[i % len(FORMS)]
        at = int(rng.integers(ENDS, settings.tosses - ENDS + 1))
        targets = tuple(float(x) for x in np.exp(rng.uniform(low, high, len(names))))
        engine = settings.engines[(i + i // len(FORMS)) % len(settings.engines)]
        case = Case(i, "effect" if names else "null", engine, names, targets, int(rng.integers(2**32)))
        cases.append(OrderCase(case, OrderOfCase(form, at if form == STEP else 0)))
    return cases


def draw_nulls(n: int, settings: AuditSettings, effects: Sequence[str]) -> list[OrderCase]:
    """The first cases in which nothing changes over the order: in turns, no effect, and one that all tosses have.

    Args:
        n: How many.
        settings: Seed, engines and displacements.
        effects: Names of effects to draw from, which all engines can simulate.
    """
    rng, (low, high) = np.random.default_rng([settings.seed, 7]), np.log(settings.displacement)
    drawn, cases = endless(list(effects), rng), list[OrderCase]()
    for i in range(n):
        of_case = (next(drawn),) if i % 2 else ()
        targets = tuple(float(x) for x in np.exp(rng.uniform(low, high, len(of_case))))
        engine = settings.engines[i // 2 % len(settings.engines)]
        case = Case(i, "effect" if of_case else "null", engine, of_case, targets, int(rng.integers(2**32)))
        cases.append(OrderCase(case, OrderOfCase(CONSTANT if of_case else NONE)))
    return cases


def cases_over_order(given: Mapping[str, str], settings: AuditSettings) -> Iterator[Tosses]:
    """The tosses of all cases in the order of recording, their object, and the truth; those with a change first.

    Args:
        given: `cases` with a change and `nulls` without; with `data`, one null in three has real tosses of this dataset
            in random order. `first` leaves out changes before; `only` is a form and `effects` their names.
        settings: How they are drawn and made.
    """
    model, (changes, nulls) = load_object("cube"), (int(given.get(key, "40")) for key in ("cases", "nulls"))
    drawn = [each for each in draw_changes(2 * changes + 1, settings) if each.order.form not in NULLS]
    real = nulls // 3 if "data" in given else 0
    only_lcp = only_in_lcp(model, settings)
    drawn = drawn[int(given.get("first", "0")) : changes]
    drawn += draw_nulls(nulls - real, settings, [name for name in strengths_for(model) if name not in only_lcp])
    for each in drawn:
        kind = each.order.form, ",".join(each.case.effects)
        if kind == (given.get("only", kind[0]), given.get("effects", kind[1])):
            yield made(each, model, settings)
    if real and given.get("only", SHUFFLED) == SHUFFLED:
        yield from shuffled(Path(given["data"]), real, settings)


def made(each: OrderCase, model: ObjectModel, settings: AuditSettings) -> Tosses:
    """The tosses of a simulated case, which pass through TUM files and are not levelled, their object, and the truth.

    Args:
        each: The case.
        model: The stated object.
        settings: How it is made.
    """
    case, synthesis = each.case, synthesis_of(each.case, settings)
    effects, reached = strengths_of(case, model, settings)
    motions, noise = np.random.default_rng([case.seed, 5]).spawn(2)
    tosses = tosses_over_order(effects, each.order, model, synthesis, motions)
    with tempfile.TemporaryDirectory() as folder:
        record(tosses, model, settings, noise, Path(folder), level="never")
        dataset = read_dataset(Path(folder) / TOSSES)
    truth = {"case": case.as_json(), "order": vars(each.order), "effects": effects, "displacement": reached}
    if each.order.form == DRIFT:
        truth["rates"] = rates(effects, World(model, gravity=synthesis.gravity), settings.tosses)
    return long_enough(dataset.tosses), dataset.object, truth


def shuffled(data: Path, count: int, settings: AuditSettings) -> Iterator[Tosses]:
    """Real tosses in random order, which means nothing, their object, and the truth.

    Args:
        data: The dataset.
        count: How many draws of it.
        settings: The seed, and how many tosses.
    """
    dataset = read_dataset(data)
    tosses = long_enough(dataset.tosses)
    for i in range(count):
        chosen = np.random.default_rng([settings.seed, 8, i]).permutation(len(tosses))[: settings.tosses]
        truth = {"case": {"index": i, "engine": "real"}, "order": {"form": SHUFFLED, "at": 0}, "effects": {}}
        yield tuple(tosses[k] for k in chosen), dataset.object, truth


def long_enough(tosses: Sequence[Toss]) -> tuple[Toss, ...]:
    """The tosses that are at least half a window long.

    Args:
        tosses: Some.
    """
    return tuple(toss for toss in tosses if len(toss) > WindowSettings().length // 2)


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


def score_over_order(truth: Mapping[str, Any], gap: Mapping[str, Any]) -> dict[str, Any]:
    """What is right and wrong in what a diagnosis says of the order.

    Args:
        truth: `order`, `effects` and, of a drift, `rates`.
        gap: The content of gap.json.

    Returns:
        `right`: all effects that change are named as such; of no change, that none is. `changing`: effects that are
        said to change; `further`: those of them that do not. `form_right`. `moment_right`: a change is within some
        tosses of the true one, whatever it is called. `rate`: the true and found change per toss of a drift. What does
        not apply is None.
    """
    form, at = truth["order"]["form"], truth["order"]["at"]
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
        out["moment_right"] = any(abs(int(start) - at) <= SAME_MOMENT for start in starts)
    elif found:
        name = min(found)
        (key,) = true[name]
        rate = changing[name].get("drift", {}).get("per_toss", {}).get(key)
        out["rate"] = None if rate is None else {"true": truth["rates"][name][key], **rate}
    return {**out, "right": found == set(true)}
