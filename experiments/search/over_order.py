"""How well changes over the order of recording are found in closed form, beside the simulator as it is stated.

    python -m experiments.search.over_order OUT.jsonl [cases=21] [nulls=30] [data=CUBE.h5] [seed=2] [boundary=TOSS]

The cases are those of `order_cases`: in `cases` something changes, in `nulls` nothing does; of a dataset, a third of
the nulls are its tosses in random order. A line of JSON a case: what was made, what was found, seconds of processor
time. Lines that are there are not made again. `over_order.md` has the table.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from experiments.search.order_cases import cases_over_order, score_over_order
from tossid.diagnosis.findings import Interval
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.order import OverOrder, over_order, windows_within
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.inference.screening import screen
from tossid.objects import ObjectModel
from tossid.physics.effects import World, effects_for
from tossid.settings.audit import AuditSettings
from tossid.types import Toss


def looked_at(tosses: Sequence[Toss], model: ObjectModel, boundaries: Sequence[int] = ()) -> tuple[OverOrder, float]:
    """What changes in tosses beside the stated simulator, and the seconds of processor time.

    Args:
        tosses: In the order of recording.
        model: The stated object.
        boundaries: First tosses of sessions.
    """
    begun, n = time.process_time(), len(tosses)
    sample = Sample(windows_within(tosses, model, (0, n)), n)
    first = sample.evidence(Hypothesis(World(model)))
    screening = screen(first, effects_for(model), n=n, rng=np.random.default_rng(0))
    windows = partial(windows_within, tosses, model)
    found = over_order(sample.fixed(first), screening, boundaries=boundaries, windows=windows)
    return found, time.process_time() - begun


def as_findings(found: OverOrder, names: Sequence[str]) -> dict[str, Any]:
    """What was found, as far as `score_over_order` reads it of a diagnosis.

    Args:
        found: The changes.
        names: Of the tosses.
    """

    def values(of: Mapping[str, Interval]) -> dict[str, Any]:
        return {name: each.as_json() for name, each in of.items()}

    effects = []
    for change in found.changes:
        one: dict[str, Any] = {"name": change.effect.name, "over_order": {"p_value": change.p_value}}
        if change.form == "steps":
            one["sessions"] = [{"first": names[s.first], "parameters": values(s.values)} for s in change.stretches]
        else:
            one["drift"] = {"per_toss": values(change.rate), "ends": [values(s.values) for s in change.stretches]}
        effects.append({**one, "gain": change.gain})
    left = [] if found.place is None else [{"before": names[found.place]}]
    return {"effects": effects, "changes_left": left, "p_left": found.left}


def main(arguments: list[str]) -> None:
    """Make what is missing of the cases."""
    out, given = Path(arguments[0]), dict(argument.split("=", 1) for argument in arguments[1:])
    settings = replace(AuditSettings(), tosses=int(given.get("tosses", "40")), seed=int(given.get("seed", "2")))
    known = len(out.read_text().splitlines()) if out.exists() else 0
    boundaries = (int(given["boundary"]),) if "boundary" in given else ()
    cases = cases_over_order({"cases": "21", "nulls": "30", **given}, settings)
    for k, (tosses, model, truth) in enumerate(cases):
        if k >= known:
            found, seconds = looked_at(tosses, model, boundaries)
            write(out, found, seconds, tosses, truth)


def write(out: Path, found: OverOrder, seconds: float, tosses: Sequence[Toss], truth: Mapping[str, Any]) -> None:
    """Add a line with a case's truth, what was found, and its score.

    Args:
        out: The file of lines.
        found: The changes.
        seconds: Of processor time.
        tosses: Of the case.
        truth: Of the case.
    """
    gap = as_findings(found, [toss.name for toss in tosses])
    about = {"order": truth["order"], "effects": truth["effects"], "engine": truth["case"]["engine"]}
    line: dict[str, Any] = {**about, "found": gap}
    line |= {"score": score_over_order(truth, gap), "seconds": round(seconds, 1)}
    with out.open("a") as file:
        file.write(json.dumps(line, default=float) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
