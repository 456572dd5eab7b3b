"""The published cube, trained from its stated object, from nothing and from random starts: where does training end?

    python -m experiments.starts OUT.jsonl FOLDER --models cn --random 20
    python -m experiments.starts OUT.jsonl FOLDER --nothing --tosses 64 16 8

FOLDER holds contactnets_cube. Of a random start nothing is right but the centre of mass, the mass and the number of
corners. Every second one has its corners evenly in a ball about the body's origin, the others have each coordinate of a
stated corner off by a normal number. Friction and, for `cnrpi`, inertia are log-uniform, and every two starts the given
gravity changes between none and 9.81 m/s². A row compares an end with that of the stated start: how far one of its
seen corners is missed, how far the learned ones are beyond, and rollouts of the held-out tosses.
"""

from __future__ import annotations

import itertools
import sys
import time
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

import tossid
from experiments.harness import Case, Line, markdown, measured, options, succeeded
from pipelines.cli.failures import guarded
from tossid.models import variant
from tossid.models.random_start import draw_start
from tossid.objects import GRAVITY, to_mjcf
from tossid.settings.objects import UnknownObjectSettings
from tossid.store import Dataset

STATED, NOTHING = "stated", "nothing"
CORNERS_MM, FRICTION, ROLLOUTS_PCT = 2.0, 0.01, 3.0
"""Largest differences from the end of the stated start that count as the same end."""
HEADS = (
    "model", "tosses", "seed", "start", "corners", "missed, beyond [mm]", "friction", "position [%]", "rotation [deg]",
    "gravity [m/s²]", "same end", "converged", "CPU s",
)  # fmt: skip


@lru_cache
def cube(folder: Path) -> Dataset:
    """The published tosses."""
    return tossid.ingest(folder / "contactnets_cube", source="contactnets")


def trained_from(case: Case, folder: Path) -> Line:
    """Where a training ends.

    Args:
        case: Its `model`, `tosses`, `seed` (which draws them) and `start`, which is a number if it is random.
        folder: Holds contactnets_cube.
    """
    dataset, start = cube(folder), case["start"]
    stated, model, unknown = dataset.object, variant(case["model"]), None
    if start == NOTHING:
        unknown = UnknownObjectSettings(mass=float(stated.mass[0]))
    elif start != STATED:
        given, _ = draw_start(
            stated, np.random.default_rng([0, start]), ball=start % 2 == 0, inertia=model.learn_inertia
        )
        dataset = replace(dataset, object=given.with_changes(mjcf=to_mjcf(given)))
        model = replace(model, gravity=(0.0, GRAVITY)[start // 2 % 2] if model.learn_inertia else GRAVITY)
    began = time.process_time()
    trained = tossid.train(dataset, model=model, object=unknown, tosses=case["tosses"], seed=case["seed"])
    seconds = time.process_time() - began
    scores = tossid.evaluate(trained, replace(dataset, object=stated).split("test"))
    mean = {
        name: value["mean"] for name, value in scores.metrics.items() if isinstance(value, dict) and "mean" in value
    }
    (geometry,) = trained.parameters["geometry"]
    return {
        "vertices": geometry["vertices_m"],
        "seen": geometry["seen"],
        "friction": trained.object.friction,
        "position": mean["position_error_pct"] * scores.stated.width / stated.width,
        "rotation": mean["rotation_error_deg"],
        "gravity": mean["gravity_ms2"],
        "converged": trained.converged,
        "cpu_s": seconds,
    }


def apart(end: Line, reference: Line) -> tuple[float, float]:
    """How far a corner that the reference has seen is from the nearest seen one of an end, and the reverse [m].

    A corner that neither has seen on the ground is not compared: no toss decides where it is.
    """
    one, two = (np.array(line["vertices"])[np.array(line["seen"], dtype=bool)] for line in (end, reference))
    if not len(one) or not len(two):
        return float("inf"), float("inf")
    distance = np.linalg.norm(one[:, None] - two[None], axis=-1)
    return float(distance.min(axis=0).max()), float(distance.min(axis=1).max())


def same_end(end: Line, reference: Line) -> bool:
    """Whether an end is that of the stated start."""
    corners = 1e3 * max(apart(end, reference)) <= CORNERS_MM
    rollouts = 100 * abs(end["position"] / reference["position"] - 1) <= ROLLOUTS_PCT
    return corners and rollouts and abs(end["friction"] - reference["friction"]) <= FRICTION


def row(end: Line, reference: Line) -> list[str]:
    """A row of the table."""
    off = ", ".join(f"{1e3 * distance:.1f}" for distance in apart(end, reference))
    figures = [f"{end[name]:.{digits}f}" for name, digits in (("friction", 3), ("position", 1), ("rotation", 1))]
    answers = ["yes" if each else "no" for each in (same_end(end, reference), end["converged"])]
    about = [f"`{end['model']}`", end["tosses"], end["seed"], end["start"], len(end["vertices"])]
    return [*map(str, about), off, *figures, f"{end['gravity']:.2f}", *answers, f"{end['cpu_s']:.0f}"]


def main(arguments: list[str]) -> None:
    """Train from the starts that OUT lacks, and print a row for each and how many end where the stated start ends."""
    given = options(
        __doc__, arguments, out=Path, folder=Path, models=("cn", "cnrpi"), tosses=(64,), seeds=(0,), random=0,
        nothing=False, processes=1,
    )  # fmt: skip
    starts = [STATED, *[NOTHING] * given.nothing, *range(given.random)]
    names = ("model", "tosses", "seed", "start")
    cases = [
        dict(zip(names, values, strict=True))
        for values in itertools.product(given.models, given.tosses, given.seeds, starts)
    ]
    measure = partial(trained_from, folder=given.folder)
    lines = list(succeeded(measured(given.out, cases, measure, processes=given.processes)))
    reference = {(line["model"], line["tosses"], line["seed"]): line for line in lines if line["start"] == STATED}
    pairs = [(line, reference[line["model"], line["tosses"], line["seed"]]) for line in lines]
    print(markdown(HEADS, (row(*pair) for pair in pairs)))
    others = [pair for pair in pairs if pair[0]["start"] != STATED]
    same = [same_end(*pair) for pair in others]
    silent = sum(end["converged"] and not each for (end, _), each in zip(others, same, strict=True))
    print(f"{sum(same)} of {len(same)} end where the stated start ends; {silent} others say that they converged")


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(sys.argv[1:]), "starts"))
