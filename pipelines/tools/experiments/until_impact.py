"""Unseen tosses predicted until their second impact.

    python -m pipelines.tools.experiments.until_impact FILE.h5 --gap gap.json

Two simulators are rolled out from first states that the first window determines under each: the stated object, and
the same with all that a diagnosis found, whether it has a name or not (`--gap`), or with given effects
(`--effects '{"friction": {"mu": 0.1}}'`). Later impacts are left out, as contact amplifies any error.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tossid.audit.strengths import world_with
from tossid.diagnosis.likelihood.windows import make_windows, steps_of
from tossid.diagnosis.localisation.rollouts import first_states
from tossid.errors import InputError
from tossid.physics.effects import World
from tossid.rotations import geodesic_angle
from tossid.store import read_dataset
from tossid.types import Phase, Toss

Array = NDArray[np.float64]


def frames_until_second_impact(toss: Toss) -> int:
    """Frames before contact begins for the second time; all of them if it does not."""
    touching = toss.phase != Phase.FLIGHT
    begins = np.flatnonzero(touching[1:] & ~touching[:-1]) + 1
    return int(begins[1]) if len(begins) > 1 else len(toss)


def errors(tosses: Sequence[Toss], world: World) -> Array:
    """(n, 2) mean distance [% of the width] and mean angle [deg] of each toss until its second impact."""
    windows = make_windows(tosses, world.object)
    q, v = first_states(tosses, world, windows)
    at = [toss.ticks(windows.dt)[: frames_until_second_impact(toss)] for toss in tosses]
    run = world.roll_out(q, v, n_steps=np.array([frames[-1] for frames in at]), dt=windows.dt, **steps_of(world))
    out = []
    for row, toss, frames in zip(run, tosses, at, strict=True):
        found, poses = row[frames], toss.measured[0][: len(frames)]
        distance = np.linalg.norm(found[:, :3] - poses[:, :3], axis=1).mean() / world.object.width
        out.append([100 * distance, np.rad2deg(geodesic_angle(found[:, 3:7], poses[:, 3:7])).mean()])
    return np.array(out)


def main() -> None:
    """Print both simulators' errors, with intervals over tosses."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--gap", type=Path, help="gap.json of a diagnosis")
    parser.add_argument("--effects", help="values by effect and parameter, as JSON")
    parser.add_argument("--split", nargs="+", default=["test"])
    given = parser.parse_args()
    if (given.gap is None) == (given.effects is None):
        raise InputError("expected either --gap or --effects")
    if given.gap is None:
        effects = json.loads(given.effects)
    else:
        effects = json.loads(given.gap.read_text())["explanation"]["hypothesis"]
    dataset = read_dataset(given.data)
    tosses, stated = [toss for split in given.split for toss in dataset.of_split(split)], World(dataset.object)
    print(f"effects: {json.dumps(effects)}")  # noqa: T201
    rng = np.random.default_rng(0)
    for name, world in (("stated", stated), ("found", world_with(stated, effects))):
        each = errors(tosses, world)
        draws = np.median(each[rng.integers(0, len(each), (1000, len(each)))], axis=1)
        low, high = np.percentile(draws, [2.5, 97.5], axis=0)
        position, angle = (
            f"{m:.1f} ({a:.1f} to {b:.1f})" for m, a, b in zip(np.median(each, 0), low, high, strict=True)
        )
        print(f"{name}: {len(each)} tosses, median {position} % of the width, {angle} deg")  # noqa: T201


if __name__ == "__main__":
    main()
