"""Do trainings find the friction and the inertia of a simulated cube whose size and mass are stated?

    python -m pipelines.tools.experiments.simulated.known_object [seeds=3] [tosses=48]

Tosses of the cube with a friction of 0.3, where 0.18 is stated, are made by tossid's engine, which is rigid, and by a
near-rigid MuJoCo, once without noise and once with a tracker's (0.15 mm, 1.5 mrad, velocities of 0.03 m/s and
0.3 rad/s). Half of them train. The table has medians over seeds, and how many 95 % intervals hold the truth.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import numpy as np

import tossid
from pipelines.cli.console import Console
from tossid.objects import load_object
from tossid.settings.synthesis import NoiseSettings

FRICTION = 0.3
NOISE = {
    "none": NoiseSettings(position=0.0, rotation=0.0, velocity=0.0, spin=0.0),
    "a tracker's": NoiseSettings(position=1.5e-4, rotation=1.5e-3, velocity=0.03, spin=0.3),
}
HEADS = ("engine", "noise", "model", "friction", "intervals", "inertia, relative", "intervals", "CPU s")


def main() -> None:
    """Print the table."""
    keys = {"seeds": 3, "tosses": 48} | {k: int(v) for k, v in (word.split("=", 1) for word in sys.argv[1:])}
    rows = [
        row(engine, noise, model, seeds=keys["seeds"], tosses=keys["tosses"])
        for engine in ("lcp", "mujoco")
        for noise in NOISE
        for model in ("cn", "cnrpi")
    ]
    Console().table(HEADS, rows, title=f"{keys['tosses']} tosses, half of them for training; {keys['seeds']} seeds")


def row(engine: str, noise: str, model: str, *, seeds: int, tosses: int) -> list[str]:
    """A row of the table.

    Args:
        engine: What makes the tosses.
        noise: Of `NOISE`.
        model: What is trained.
        seeds: How many sets of tosses.
        tosses: In a set.
    """
    stated = load_object("cube")
    true = stated.with_changes(friction=FRICTION)
    frictions, inertias, right = [], [], {"friction": [0, 0], "inertia": [0, 0]}
    before = time.process_time()
    for seed in range(seeds):
        made = tossid.synthesize(true, engine=engine, tosses=tosses, seed=seed, noise=NOISE[noise])
        trained = tossid.train(replace(made, object=stated), model=model, threads=1)
        learned = trained.model.learned_object()
        frictions.append(float(learned.friction))
        inertias.append(float(np.trace(learned.inertia[0]) / np.trace(true.inertia[0])))
        for name, found in trained.intervals.items():
            axis = {"inertia_xx_kgm2": 0, "inertia_yy_kgm2": 1, "inertia_zz_kgm2": 2}.get(name)
            if found["ci95"] is None or (name != "friction" and axis is None):
                continue
            truth = FRICTION if axis is None else float(true.inertia[0][axis, axis])
            kept = right["friction" if axis is None else "inertia"]
            kept[0] += found["ci95"][0] <= truth <= found["ci95"][1]
            kept[1] += 1
    seconds = (time.process_time() - before) / seeds
    counts = [f"{hit} of {of}" if of else "-" for hit, of in right.values()]
    return [
        engine,
        noise,
        model,
        f"{np.median(frictions):.3f} ({min(frictions):.3f} to {max(frictions):.3f})",
        counts[0],
        f"{np.median(inertias):.3f} ({min(inertias):.3f} to {max(inertias):.3f})",
        counts[1],
        f"{seconds:.0f}",
    ]


if __name__ == "__main__":
    main()
