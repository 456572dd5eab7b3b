"""How well changes over the order of recording are found, and whether intervals after a step hold.

    python -m experiments.search.over_order OUT.jsonl --changes 21 --nulls 30 --data CUBE.h5

An effect steps or drifts over the order of the tosses, or all tosses have it, or none. The effect, the toss at which it
steps and its size are drawn as those of an audit's cases are. Of `--data`, a dataset, a third of the nulls are its
tosses in random order, which means nothing. A case is diagnosed from the nominal cube, and is not levelled before.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import tossid
from experiments.harness import Case, Line, markdown, measured, options, succeeded
from pipelines.cli.failures import guarded
from tossid.audit.cases import Case as AuditCase
from tossid.audit.cases import endless
from tossid.audit.making import TOSSES, record, strengths_of, synthesis_of
from tossid.audit.run import only_in_lcp
from tossid.audit.strengths import strengths_for
from tossid.objects import ObjectModel, load_object
from tossid.physics.effects import World, effect_named
from tossid.physics.effects.strength import Values
from tossid.settings.audit import AuditSettings
from tossid.settings.synthesis import SynthesizeSettings
from tossid.store import Dataset, read_dataset
from tossid.synthesis.tosses import make_tosses
from tossid.types import Toss

STEP, DRIFT, NONE, CONSTANT, SHUFFLED = "step", "drift", "none", "constant", "shuffled"
"""What an effect does over the order. `NONE`: there is none; `CONSTANT`: all tosses have it; `SHUFFLED`: whatever real
tosses have, in an order that means nothing."""
CHANGES = (
    (STEP, ("world_tilt",)),
    (STEP, ("ground_height",)),
    (STEP, ("time_base",)),
    (STEP, ("world_tilt", "ground_height")),
    (STEP, ("friction",)),
    (DRIFT, ("time_base",)),
    (DRIFT, ("friction",)),
    (NONE, ()),
)
"""In turns: a table or camera that was tilted, raised, moved (both), a clock, a surface that was cleaned; a clock and a
surface that drift; and nothing."""
ENDS = 8
"""Tosses on each side of a step at least."""
SAME_MOMENT = 3
"""Tosses by which a step may be found off."""


def drawn(changes: int, nulls: int, settings: AuditSettings) -> list[Case]:
    """So many cases with a change, then so many without: in turns, no effect, and one that all tosses have.

    Args:
        changes: How many of the first.
        nulls: How many of the second.
        settings: Seed, engines, displacements and number of tosses.
    """
    low, high = np.log(settings.displacement)

    def case(rng: np.random.Generator, form: str, names: Sequence[str], turn: int, at: int = 0) -> Case:
        targets = np.exp(rng.uniform(low, high, len(names))).tolist()
        engine = settings.engines[turn % len(settings.engines)]
        seed = int(rng.integers(2**32))
        return {"form": form, "effects": list(names), "engine": engine, "at": at, "targets": targets, "seed": seed}

    of_changes, of_nulls = (np.random.default_rng([settings.seed, k]) for k in (6, 7))
    found = []
    for i in range(2 * changes + 1):
        form, names = CHANGES[i % len(CHANGES)]
        at = int(of_changes.integers(ENDS, settings.tosses - ENDS + 1))
        found.append(case(of_changes, form, names, i + i // len(CHANGES), at if form == STEP else 0))
    found = [each for each in found if each["form"] != NONE][:changes]
    model = load_object("cube")
    only_lcp = only_in_lcp(model, settings)
    effects = endless([name for name in strengths_for(model) if name not in only_lcp], of_nulls)
    for i in range(nulls):
        found.append(case(of_nulls, CONSTANT if i % 2 else NONE, [next(effects)] if i % 2 else [], i // 2))
    return found


def made(case: Case, model: ObjectModel, settings: AuditSettings) -> tuple[Dataset, dict[str, Values]]:
    """The tosses of a case as they are recorded, and the whole values of its effects.

    Args:
        case: As `drawn` gives it.
        model: The stated object.
        settings: How many tosses, and their noise.
    """
    about = AuditCase(0, "effect", case["engine"], tuple(case["effects"]), tuple(case["targets"]), case["seed"])
    effects, _ = strengths_of(about, model, settings)
    order = np.arange(settings.tosses)
    shares = {STEP: order >= case["at"], CONSTANT: order >= 0, DRIFT: order / order[-1], NONE: order < 0}[case["form"]]
    motions, noise = np.random.default_rng([case["seed"], 5]).spawn(2)
    tosses = tosses_over_order(effects, shares.astype(float), model, synthesis_of(about, settings), motions)
    with tempfile.TemporaryDirectory() as folder:
        record(tosses, model, settings, noise, Path(folder))
        return read_dataset(Path(folder) / TOSSES), effects


def tosses_over_order(
    effects: Mapping[str, Values],
    shares: NDArray[np.float64],
    model: ObjectModel,
    synthesis: SynthesizeSettings,
    rng: np.random.Generator,
) -> tuple[Toss, ...]:
    """Tosses whose effects go over their order, otherwise as `make_tosses` makes them.

    Args:
        effects: Whole values, by effect and parameter.
        shares: (n,) how much of them each toss has, 0 to 1.
        model: What is tossed.
        synthesis: How it is simulated.
        rng: What draws the releases.
    """
    nominal = World(model, gravity=synthesis.gravity)
    edges = [0, *(np.flatnonzero(np.diff(shares)) + 1).tolist(), len(shares)]
    tosses: list[Toss] = []
    for first, stop in pairwise(edges):
        own = {}
        for name, values in effects.items() if shares[first] else ():
            before = effect_named(name).named(effect_named(name).nominal(nominal))
            own[name] = {key: before[key] + shares[first] * (value - before[key]) for key, value in values.items()}
        tosses += make_tosses(replace(synthesis, effects=own, tosses=stop - first), model, rng)[0]
    return in_order(tosses)


def in_order(tosses: Iterable[Toss]) -> tuple[Toss, ...]:
    """The tosses, named by their order."""
    return tuple(replace(toss, name=f"{i:03d}") for i, toss in enumerate(tosses))


def diagnosed(case: Case, settings: AuditSettings, data: str) -> Line:
    """What a diagnosis says of a case, and what of it is right.

    Args:
        case: As `drawn` gives it, or a number of real tosses in random order.
        settings: How tosses are made.
        data: The dataset of the real ones.
    """
    if case["form"] == SHUFFLED:
        dataset, effects = read_dataset(Path(data)), dict[str, Values]()
        order = np.random.default_rng([settings.seed, 8, case["seed"]]).permutation(len(dataset.tosses))
        dataset = replace(dataset, tosses=in_order(dataset.tosses[k] for k in order[: settings.tosses]))
    else:
        dataset, effects = made(case, load_object("cube"), settings)
    began = time.process_time()
    gap = tossid.diagnose(dataset, "nominal", repeats=0, threads=1, tosses=len(dataset)).as_json()
    return {"truth": effects, **scored(case, effects, gap), "seconds": round(time.process_time() - began, 1)}


def scored(case: Case, effects: Mapping[str, Values], gap: Mapping[str, Any]) -> dict[str, Any]:
    """What is right and wrong in what a diagnosis says of the order.

    Args:
        case: Its `form` and the toss `at` which an effect steps.
        effects: True values.
        gap: The content of gap.json.

    Returns:
        `right`: all effects that change are named as such; of no change, that none is. `changing`: effects that are
        said to change, and how; `further`: those of them that do not. `moment_right`: a step is within some tosses of
        the true one, whatever it is called. `held`: whether intervals after a step hold the true values.
    """
    changing = {f["name"]: f for f in gap["effects"] if "over_order" in f}
    left = [change["before"] for change in gap.get("changes_left") or []]
    moments = [session["first"] for f in changing.values() for session in f.get("sessions", [])[1:]] + left
    forms = {name: STEP if "sessions" in f else DRIFT for name, f in changing.items()}
    true = effects if case["form"] in (STEP, DRIFT) else {}
    after = {name: changing[name]["sessions"][-1]["parameters"] for name in true if forms.get(name) == STEP}
    return {
        "right": set(true) <= set(changing) if true else not changing and not left,
        "changing": forms,
        "further": sorted(set(changing) - set(true)),
        "moment_right": any(abs(int(moment) - case["at"]) <= SAME_MOMENT for moment in moments),
        "held": {
            f"{name}.{key}": bool(value["ci95"][0] <= true[name][key] <= value["ci95"][1])
            for name, values in after.items()
            for key, value in values.items()
            if case["form"] == STEP
        },
    }


def row(lines: Sequence[Line], form: str, effects: str, engine: str) -> list[str]:
    """A row of the table: of so many cases, how many are right."""
    held = [each for line in lines for each in line["held"].values()]
    counts = [[bool(line[key]) for line in lines] for key in ("right", "moment_right", "further")]
    said = [f"{sum(each)} of {len(each)}" for each in (*counts, held)]
    return [form, effects, engine, *said]


def main(arguments: list[str]) -> None:
    """Make and diagnose the cases that OUT lacks, and print how many are right."""
    given = options(__doc__, arguments, out=Path, changes=21, nulls=30, data="", tosses=40, seed=2, processes=1)
    settings = replace(AuditSettings(), tosses=given.tosses, seed=given.seed)
    real = given.nulls // 3 if given.data else 0
    cases = drawn(given.changes, given.nulls - real, settings)
    cases += [{"form": SHUFFLED, "effects": [], "engine": "real", "at": 0, "seed": k} for k in range(real)]
    measure = partial(diagnosed, settings=settings, data=given.data)
    groups: dict[tuple[str, str, str], list[Line]] = {}
    for line in succeeded(measured(given.out, cases, measure, processes=given.processes)):
        name = ", ".join(line["effects"]) if line["form"] in (STEP, DRIFT) else ""
        groups.setdefault((line["form"], name, line["engine"]), []).append(line)
    heads = ("form", "effects", "engine", "right", "step within 3 tosses", "names that do not change", "intervals hold")
    print(markdown(heads, (row(lines, *group) for group, lines in groups.items())))


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(sys.argv[1:]), "over_order"))
