"""How many 95 % intervals of learned parameters hold the truth?

    python -m experiments.coverage OUT.jsonl --sets 100 --seed 5000

Each set has another cube: its friction, centre of mass and moments of inertia are drawn. It is tossed by tossid's
engine or by MuJoCo in turn, 8, 12 or 20 times in turn, of which half train. Poses and velocities have a tracker's
noise. Each model is trained on each set. `cn` and `cnrp` learn no inertia: they are given the true one. True contact is
rigid: an interval of stiffness does not hold the truth, and one of relaxation or cohesion has to hold 0.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

import tossid
from experiments.harness import Case, Line, markdown, measured, options, succeeded
from pipelines.cli.failures import guarded
from tossid.objects import ObjectModel, load_object
from tossid.settings.synthesis import NoiseSettings

NOISE = NoiseSettings(position=1.5e-4, rotation=1.5e-3, velocity=0.03, spin=0.3)
MODELS, ENGINES, TOSSES = ("cn", "cnrp", "cnrpi"), ("lcp", "mujoco"), (8, 12, 20)
KINDS = ("friction", "com", "inertia", "contact law")
HEADS = ("model", "engine", *KINDS, "all", "share", "not determined")


def one_set(case: Case) -> Line:
    """All parameters that the models learn from a set of tosses, and whether an interval holds the truth.

    None stands for a parameter that the tosses do not determine.

    Args:
        case: The number of the `set`, and the `seed` of all sets.
    """
    index, stated, rng = case["set"], load_object("cube"), np.random.default_rng([case["seed"], case["set"]])
    true = drawn(stated, rng)
    engine, tosses = ENGINES[index % len(ENGINES)], TOSSES[index // len(ENGINES) % len(TOSSES)]
    made = tossid.synthesize(true, engine=engine, tosses=tosses, seed=int(rng.integers(2**31)), noise=NOISE)
    found = []
    for model in MODELS:
        given = stated if model == "cnrpi" else stated.with_changes(com=true.com, inertia=true.inertia)
        trained = tossid.train(replace(made, object=given), model=model, threads=1)
        for name, each in trained.intervals.items():
            kind = next((kind for kind in KINDS if name.startswith(kind)), KINDS[-1])
            ends = each["ci95"]
            holds = None if ends is None else bool(ends[0] <= truth_of(name, true) <= ends[1])
            found.append({"model": model, "engine": engine, "kind": kind, "holds": holds})
    return {"found": found}


def drawn(stated: ObjectModel, rng: np.random.Generator) -> ObjectModel:
    """The object with another friction, centre of mass and inertia.

    Args:
        stated: The object.
        rng: What draws.
    """
    moments = np.diag(stated.inertia[0]) * rng.uniform(0.85, 1.2) * np.exp(0.04 * rng.normal(size=3))
    return stated.with_changes(
        friction=float(rng.uniform(0.12, 0.4)),
        com=stated.com + 2e-3 * rng.normal(size=(1, 3)),
        inertia=np.diag(moments)[None],
    )


def truth_of(name: str, true: ObjectModel) -> float:
    """What a parameter is in truth.

    Args:
        name: As of `TrainedModel.intervals`.
        true: The object.
    """
    if name == "friction":
        return true.friction
    quantity, axis = name.split("_")[:2]
    if quantity == "com":
        return float(true.com[0, "xyz".index(axis)])
    if quantity == "inertia":
        return float(true.inertia[0].diagonal()["xyz".index(axis[0])])
    return np.inf if quantity == "stiffness" else 0.0


def row(found: Iterable[Line], model: str, engine: str) -> list[str]:
    """A row of the table.

    Args:
        found: All parameters.
        model: Whose, or "all".
        engine: Whose, or "all".
    """
    own = [each for each in found if model in (each["model"], "all") and engine in (each["engine"], "all")]
    held = {kind: [e["holds"] for e in own if e["kind"] == kind and e["holds"] is not None] for kind in KINDS}
    every = [holds for kind in KINDS for holds in held[kind]]
    counts = [f"{sum(each)} of {len(each)}" if each else "-" for each in (*held.values(), every)]
    share = f"{100 * np.mean(every):.0f} %" if every else "-"
    return [model, engine, *counts, share, f"{len(own) - len(every)} of {len(own)}"]


def main(arguments: list[str]) -> None:
    """Train on the sets that OUT lacks, and print how many intervals hold the truth."""
    given = options(__doc__, arguments, out=Path, sets=100, seed=5000, processes=1)
    cases = [{"set": number, "seed": given.seed} for number in range(given.sets)]
    lines = succeeded(measured(given.out, cases, one_set, processes=given.processes))
    found = [each for line in lines for each in line["found"]]
    groups = [(model, engine) for model in (*MODELS, "all") for engine in ENGINES]
    print(markdown(HEADS, (row(found, *group) for group in (*groups, ("all", "all")))))


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(sys.argv[1:]), "coverage"))
