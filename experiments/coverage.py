"""How many 95 % intervals of learned parameters hold the truth?

    python -m experiments.coverage [sets=100] [seed=0]

Each set has another cube: its friction, centre of mass and moments of inertia are drawn. It is tossed by tossid's
engine or by MuJoCo in turn, 8, 12 or 20 times in turn, of which half train. Poses and velocities have a tracker's
noise. Each model is trained on each set. `cn` and `cnrp` learn no inertia: they are given the true one. True contact is
rigid: an interval of stiffness does not hold the truth, and one of relaxation or cohesion has to hold 0.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

import tossid
from pipelines.cli.console import Console
from tossid.objects import ObjectModel, load_object
from tossid.settings.synthesis import NoiseSettings

NOISE = NoiseSettings(position=1.5e-4, rotation=1.5e-3, velocity=0.03, spin=0.3)
MODELS, ENGINES, TOSSES = ("cn", "cnrp", "cnrpi"), ("lcp", "mujoco"), (8, 12, 20)
KINDS = ("friction", "com", "inertia", "contact law")
HEADS = ("model", "engine", *KINDS, "all", "share", "not determined")


@dataclass(frozen=True)
class Found:
    """A parameter of a training.

    Attributes:
        model: That was trained.
        engine: That made the tosses.
        kind: Of `KINDS`.
        holds: Whether its interval holds the truth; None where the tosses do not determine it.
    """

    model: str
    engine: str
    kind: str
    holds: bool | None


def main() -> None:
    """Train on all sets and print the table."""
    keys = {"sets": 100, "seed": 0} | {k: int(v) for k, v in (word.split("=", 1) for word in sys.argv[1:])}
    console, found = Console(), list[Found]()
    with console.progress("training", keys["sets"], unit="sets") as bar:
        for i in range(keys["sets"]):
            found += one_set(i, seed=keys["seed"])
            bar.advance(1)
    rows = [row(found, model, engine) for model in MODELS for engine in ENGINES]
    rows += [row(found, "all", engine) for engine in ENGINES] + [row(found, "all", "all")]
    console.table(HEADS, rows, title=f"95 % intervals that hold the truth, {keys['sets']} sets, seed {keys['seed']}")


def one_set(index: int, *, seed: int) -> list[Found]:
    """All parameters that the models learn from a set of tosses.

    Args:
        index: Of the set.
        seed: Of all sets.
    """
    stated, rng = load_object("cube"), np.random.default_rng([seed, index])
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
            holds = None if ends is None else ends[0] <= truth_of(name, true) <= ends[1]
            found.append(Found(model, engine, kind, holds))
    return found


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


def row(found: Iterable[Found], model: str, engine: str) -> list[str]:
    """A row of the table.

    Args:
        found: All parameters.
        model: Whose, or "all".
        engine: Whose, or "all".
    """
    own = [each for each in found if model in (each.model, "all") and engine in (each.engine, "all")]
    held = {kind: [e.holds for e in own if e.kind == kind and e.holds is not None] for kind in KINDS}
    every = [holds for kind in KINDS for holds in held[kind]]
    counts = [f"{sum(each)} of {len(each)}" if each else "-" for each in (*held.values(), every)]
    share = f"{100 * np.mean(every):.0f} %" if every else "-"
    return [model, engine, *counts, share, f"{len(own) - len(every)} of {len(own)}"]


if __name__ == "__main__":
    main()
