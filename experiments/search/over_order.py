"""How well changes over the order of recording are found and undone, and whether their intervals hold.

    python -m experiments.search.over_order OUT.jsonl [cases=21] [nulls=30] [data=CUBE.h5] [seed=2] [boundary=TOSS]

The cases are those of `order_cases`: in `cases` something changes, in `nulls` nothing does; of a dataset, a third of
the nulls are its tosses in random order. A line of JSON a case: what was made, what was found, seconds of processor
time, of all and of the searches alone. Lines that are there are not made again. At the end, it says how many intervals
after a step hold the true value, by engine and effect. `docs/results/diagnosis.md` has the table.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

from experiments.search.order_cases import STEP, cases_over_order, score_over_order
from tossid.diagnosis.inference.evidence import Evidence
from tossid.diagnosis.inference.found import Found
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.search import Search
from tossid.diagnosis.over_order import changes_left, findings_over_order, without_changes
from tossid.diagnosis.problem import Problem
from tossid.objects import ObjectModel
from tossid.physics.effects import World, effects_for
from tossid.settings.audit import AuditSettings
from tossid.types import Toss


def looked_at(tosses: Sequence[Toss], model: ObjectModel, boundaries: Sequence[int] = ()) -> dict[str, Any]:
    """What a diagnosis finds over the order of tosses, as gap.json has it, and the seconds of processor time.

    Args:
        tosses: In the order of recording.
        model: The stated object.
        boundaries: First tosses of sessions.
    """
    searched, run = [0.0], Search.run

    def timed(search: Search, first: Evidence | None = None) -> Found:
        begun = time.process_time()
        found = run(search, first)
        searched[0] += time.process_time() - begun
        return found

    sessions = tuple(tosses[k].name for k in boundaries)
    problem = Problem(tosses, Hypothesis(World(model)), library=effects_for(model), sessions=sessions).in_order()
    begun = time.process_time()
    with patch.object(Search, "run", timed):
        undone = without_changes(problem)
    seconds = time.process_time() - begun
    left = changes_left(undone, problem.tosses) or ()
    return {
        "effects": [finding.as_json() for finding in findings_over_order(undone, problem.tosses)],
        "changes_left": [each.as_json() for each in left],
        "p_left": undone.left.left,
        "in_all_tosses": list(undone.found.hypothesis.names),
        "seconds": round(seconds, 1),
        "seconds_of_searches": round(searched[0], 1),
    }


def main(arguments: list[str]) -> None:
    """Make what is missing of the cases, and say which intervals hold."""
    out, given = Path(arguments[0]), dict(argument.split("=", 1) for argument in arguments[1:])
    settings = replace(AuditSettings(), tosses=int(given.get("tosses", "40")), seed=int(given.get("seed", "2")))
    known = len(out.read_text().splitlines()) if out.exists() else 0
    boundaries = (int(given["boundary"]),) if "boundary" in given else ()
    cases = cases_over_order({"cases": "21", "nulls": "30", **given}, settings)
    for k, (tosses, model, truth) in enumerate(cases):
        if k >= known:
            gap = looked_at(tosses, model, boundaries)
            about = {"order": truth["order"], "effects": truth["effects"], "engine": truth["case"]["engine"]}
            with out.open("a") as file:
                line = {**about, "found": gap, "score": score_over_order(truth, gap)}
                file.write(json.dumps(line, default=float) + "\n")
    print_intervals([json.loads(line) for line in out.read_text().splitlines()])


def print_intervals(lines: Sequence[Mapping[str, Any]]) -> None:
    """How many intervals after a step hold the true value.

    Args:
        lines: Of the file.
    """
    held: dict[tuple[str, str], list[bool]] = {}
    for line in lines:
        for name, low, true, high in intervals_of(line):
            held.setdefault((line["engine"], name), []).append(low <= true <= high)
    for (engine, name), each in sorted(held.items()):
        sys.stdout.write(f"{engine} {name}: {sum(each)} of {len(each)} intervals hold\n")


def intervals_of(line: Mapping[str, Any]) -> Iterator[tuple[str, float, float, float]]:
    """Names of effects that step, with each parameter's interval after the step and its true value between.

    Args:
        line: Of a case.
    """
    for effect in line["found"]["effects"]:
        true = line["effects"].get(effect["name"])
        if line["order"]["form"] == STEP and true is not None and "sessions" in effect:
            for key, value in effect["sessions"][-1]["parameters"].items():
                low, high = value["ci95"]
                yield effect["name"], low, true[key], high


if __name__ == "__main__":
    main(sys.argv[1:])
