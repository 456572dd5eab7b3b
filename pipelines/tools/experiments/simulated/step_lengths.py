"""How motions after an impact depend on the length of time steps, in tossid's engine.

    python -m pipelines.tools.experiments.simulated.step_lengths [tosses=400] [restitution=0.3] [friction=0.18]
                                                                 [rolling=0.05] [adhesion=1.0] [com=0.004]

Releases of the cube are simulated in steps of several lengths, and in steps four times as short as the shortest. The
table has the signed error of the height some frames after the first impact, and the distance of the centre. The keys
are what the cube has: rolling resistance as a radius [m], adhesion [N], the centre of mass off its origin [m].
"""

from __future__ import annotations

import sys
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from tossid.objects import corner_heights, load_object
from tossid.physics import simulate
from tossid.physics.effects import World
from tossid.physics.forces import Law
from tossid.rotations import quat_exp

Array = NDArray[np.float64]
DT, FRAMES = 1 / 148, 40
SUBSTEPS = (1, 2, 4, 16, 64)
AFTER = (2, 6, 12)
"""Frames after the first impact."""
JUMP = 0.2
"""Change of the vertical velocity in a frame, beyond gravity's, that is an impact [m/s]."""
DEFAULTS = {"tosses": 400.0, "restitution": 0.3, "friction": 0.18, "rolling": 0.0, "adhesion": 0.0, "com": 0.0}


def releases(count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Poses (B, 7) and velocities (B, 6) of cubes that turn, 5 to 8 cm above the ground, with any attitude.

    Args:
        count: B.
        rng: For the draw.
    """
    q = np.zeros((count, 7))
    q[:, 3:] = quat_exp(rng.normal(size=(count, 3)))
    lowest = corner_heights(load_object("cube"), q).min(axis=1)
    q[:, 2] = rng.uniform(0.05, 0.08, count) - lowest
    across, down, spin = (
        0.5 * rng.normal(size=(count, 2)),
        -rng.uniform(0, 1, (count, 1)),
        4 * rng.normal(size=(count, 3)),
    )
    return q, np.concatenate([across, down, spin], axis=1)


def thrown(values: Mapping[str, float]) -> World:
    """The cube with these values of `DEFAULTS`.

    Args:
        values: By name.
    """
    cube = load_object("cube")
    com = cube.com.copy()
    com[0, 0] += values["com"]
    cube = cube.with_changes(restitution=values["restitution"], friction=values["friction"], com=com)
    return World(cube, law=Law(rolling=values["rolling"], adhesion=values["adhesion"]))


def errors(values: Mapping[str, float]) -> Array:
    """(steps, frames after, tosses, 3) error of the centre's position after the first impact [m].

    Args:
        values: Of `DEFAULTS`.
    """
    q, v = releases(int(values["tosses"]), np.random.default_rng(0))
    system = thrown(values).system()
    runs = [
        simulate(system, q, v, n_steps=FRAMES, dt=DT, substeps=substeps, impact_parts=8)
        for substeps in (*SUBSTEPS, 4 * SUBSTEPS[-1])
    ]
    reference = runs.pop()
    jumps = np.abs(np.diff(reference.v[..., 2], axis=1) + 9.81 * DT) > JUMP
    hit, each = jumps.argmax(axis=1), np.arange(len(q))
    frames = [np.minimum(hit + after, FRAMES) for after in AFTER]
    return np.array([[(run.q - reference.q)[each, frame, :3] for frame in frames] for run in runs])


def table(found: Array) -> str:
    """The errors in Markdown.

    Args:
        found: As `errors` returns them.
    """
    frames = [f"{after} frames" for after in AFTER]
    heads = [f"height, {each}: median, mean [µm]" for each in frames]
    heads += [f"distance, {each}: median, 90 % [µm]" for each in frames]
    rows = [f"| steps a frame | {' | '.join(heads)} |", "|---" * (1 + len(heads)) + "|"]
    for substeps, of in zip(SUBSTEPS, 1e6 * found, strict=True):
        far = np.linalg.norm(of, axis=-1)
        cells = [f"{np.median(each):.1f}, {each.mean():.1f}" for each in of[..., 2]]
        cells += [f"{np.median(each):.0f}, {np.quantile(each, 0.9):.0f}" for each in far]
        rows.append(f"| {substeps} | {' | '.join(cells)} |")
    return "\n".join(rows)


def main(arguments: list[str]) -> None:
    """Print the table.

    Args:
        arguments: `key=value` each.
    """
    given = {name: float(value) for name, value in (each.split("=", 1) for each in arguments)}
    if unknown := sorted(set(given) - set(DEFAULTS)):
        raise SystemExit(f"there is no key {', '.join(unknown)}; expected {', '.join(DEFAULTS)}")
    sys.stdout.write(table(errors({**DEFAULTS, **given})) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
