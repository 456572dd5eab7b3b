"""How motions after an impact depend on the length of time steps, in tossid's engine.

    python -m pipelines.tools.experiments.simulated.step_lengths [tosses=400] [restitution=0.3]

Releases of the cube are simulated in steps of several lengths. The table has the error of the
height one, two and six frames after the first impact, against steps eight times as short as the shortest.
"""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray

from tossid.objects import corner_positions, load_object
from tossid.physics import make_system, simulate
from tossid.rotations import quat_exp

Array = NDArray[np.float64]
DT, FRAMES = 1 / 148, 40
SUBSTEPS = (4, 8, 16, 64)
AFTER = (1, 2, 6)
"""Frames after the first impact."""
JUMP = 0.2
"""Change of the vertical velocity in a frame, beyond gravity's, that is an impact [m/s]."""


def releases(count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Poses (B, 7) and velocities (B, 6) of cubes that turn, 5 to 8 cm above the ground, with any attitude.

    Args:
        count: B.
        rng: For the draw.
    """
    q = np.zeros((count, 7))
    q[:, 3:] = quat_exp(rng.normal(size=(count, 3)))
    lowest = corner_positions(load_object("cube"), q)[..., 2].min(axis=1)
    q[:, 2] = rng.uniform(0.05, 0.08, count) - lowest
    across, down, spin = (
        0.5 * rng.normal(size=(count, 2)),
        -rng.uniform(0, 1, (count, 1)),
        4 * rng.normal(size=(count, 3)),
    )
    return q, np.concatenate([across, down, spin], axis=1)


def errors(count: int, restitution: float = 0.3) -> Array:
    """(steps, frames after, 2) median and mean error of the height after the first impact [m].

    Args:
        count: How many releases.
        restitution: Of the cube.
    """
    q, v = releases(count, np.random.default_rng(0))
    system = make_system(load_object("cube").with_changes(restitution=restitution))
    runs = [
        simulate(system, q, v, n_steps=FRAMES, dt=DT, substeps=substeps, impact_parts=8)
        for substeps in (*SUBSTEPS, 8 * SUBSTEPS[-1])
    ]
    reference = runs.pop()
    jumps = np.abs(np.diff(reference.v[..., 2], axis=1) + 9.81 * DT) > JUMP
    hit, each = jumps.argmax(axis=1), np.arange(count)
    out = np.empty((len(SUBSTEPS), len(AFTER), 2))
    for i, run in enumerate(runs):
        for j, after in enumerate(AFTER):
            frame = np.minimum(hit + after, FRAMES)
            error = run.q[each, frame, 2] - reference.q[each, frame, 2]
            out[i, j] = np.median(error), error.mean()
    return out


def table(found: Array) -> str:
    """The errors in Markdown.

    Args:
        found: As `errors` returns them.
    """
    head = " | ".join(f"{after} frames: median, mean [µm]" for after in AFTER)
    rows = [f"| steps a frame | {head} |", "|---" * (1 + len(AFTER)) + "|"]
    for substeps, of in zip(SUBSTEPS, found, strict=True):
        rows.append(f"| {substeps} | " + " | ".join(f"{1e6 * m:.1f}, {1e6 * mean:.1f}" for m, mean in of) + " |")
    return "\n".join(rows)


def main(arguments: list[str]) -> None:
    """Print the table.

    Args:
        arguments: `key=value` each.
    """
    given = dict(each.split("=", 1) for each in arguments)
    found = errors(int(given.pop("tosses", 400)), float(given.pop("restitution", 0.3)))
    if given:
        raise SystemExit(f"there is no key {', '.join(given)}; expected tosses, restitution")
    sys.stdout.write(table(found) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
