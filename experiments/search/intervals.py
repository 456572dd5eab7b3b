"""Do the intervals of a diagnosis's values hold the truth? Known effects, fitted from values that are off by 15 %.

    python -m experiments.search.intervals OUT.jsonl --seeds 121 122 123 124

The search for effects is left out, so that a case takes seconds. A line of JSON a case: true values, those where the
search's fit ends, and the final ones, with the intervals of each. The shares that hold the truth are printed.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from experiments.search.made_cases import CASES, made
from tossid.diagnosis.findings import Interval
from tossid.diagnosis.inference.final_values import DEGREES, SHIFTS, final_values
from tossid.diagnosis.inference.found import Found
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.simulators import read_simulator
from tossid.objects import ObjectModel, load_object
from tossid.physics.effects import effect_named

DEFAULT = ("friction", "rebound", "cohesion", "inertia", "size", "two_frictions", "four", "four_others")
TOSSES = 20
OFF = 0.15
"""Share of each effect by which the fit begins beside the truth."""


def case(model: ObjectModel, name: str, seed: int) -> dict[str, Any]:
    """The values of one case: true, where a search's fit ends, and final.

    Args:
        model: The stated object.
        name: Of the case.
        seed: Of its tosses.
    """
    engine, effects = CASES[name]
    dataset = made(model, engine, effects, TOSSES, seed)
    simulator = read_simulator("nominal", dataset.object)
    h, truth = Hypothesis(simulator.world, simulator.law), dict[str, float]()
    problem = Problem(dataset.tosses, h)
    for effect_name, known in effects.items():
        effect = effect_named(effect_name)
        nominal = effect.nominal(h.world())
        values = np.array([known.get(p.name, x) for p, x in zip(effect.parameters, nominal, strict=True)])
        truth |= {p.name: float(x) for p, x in zip(effect.parameters, values, strict=True)}
        h = h.plus(effect, values + OFF * (values - nominal))
    sample = problem.sample
    fitted = sample.refitted(sample.evidence(h), h, iterations=6)
    fitted = sample.refitted(fitted.evidence, fitted.hypothesis, iterations=4)
    found = Found(sample.evidence(problem.stated), fitted, None, ())
    final = final_values(found, [sample, *map(problem.shifted, SHIFTS)])
    before, after = dict[str, Interval](), dict[str, Interval]()
    for effect_name in h.names:
        before |= fitted.intervals(effect_name)
        after |= final.found.fit.intervals(effect_name, final.variance[effect_name], DEGREES)
    intervals = {"fit": before, "final": after}
    return {
        "case": name,
        "seed": seed,
        "truth": truth,
        **{kind: {key: x.as_json() for key, x in each.items()} for kind, each in intervals.items()},
    }


def holding(lines: list[dict[str, Any]], kind: str) -> str:
    """How many intervals of a kind hold the truth, in words."""
    inside = [
        low <= line["truth"][key] <= high
        for line in lines
        for key, (low, high) in ((key, x["ci95"]) for key, x in line[kind].items())
    ]
    return f"{kind}: {sum(inside)} of {len(inside)} intervals of 95 % hold the truth"


def main() -> None:
    """Make what is missing of the asked cases, and count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--cases", nargs="*", default=list(DEFAULT))
    parser.add_argument("--seeds", type=int, nargs="*", default=[121])
    given = parser.parse_args()
    lines = [json.loads(line) for line in given.out.read_text().splitlines()] if given.out.exists() else []
    known, model = {(line["case"], line["seed"]) for line in lines}, load_object("cube")
    for seed in given.seeds:
        for name in given.cases:
            if (name, seed) in known:
                continue
            line = case(model, name, seed)
            lines.append(line)
            with given.out.open("a") as file:
                file.write(json.dumps(line) + "\n")
            print(f"{name} {seed}: {line['final']}", file=sys.stderr)
    for kind in ("fit", "final"):
        print(holding(lines, kind))


if __name__ == "__main__":
    main()
