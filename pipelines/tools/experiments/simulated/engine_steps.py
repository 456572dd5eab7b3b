"""How far engines are from tossid's own on the same releases, by their time steps and approximations.

    python -m pipelines.tools.experiments.simulated.engine_steps [tosses=12] [seed=5]

A row an engine: the median over tosses of the mean distance over 75 frames [mm]. Engines that are not installed are
left out. Contact turns small differences into large ones, so two right solvers of one rigid body differ here too.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np

from tossid.errors import ConfigError
from tossid.objects import GRAVITY, OBJECT_FILES, load_object
from tossid.physics.effects import World
from tossid.settings.synthesis import (
    BulletEngine,
    DrakeEngine,
    Engine,
    LcpEngine,
    MujocoEngine,
    ReleaseSettings,
)
from tossid.synthesis.engines import ENGINES
from tossid.synthesis.tosses import draw_releases

FRAMES, RATE = 75, 148.0
STEPS = (32, 128, 512)
OTHERS: dict[str, Engine] = {
    "mujoco, near rigid": MujocoEngine(),
    **{f"bullet, {n} steps a frame": BulletEngine(substeps=n) for n in STEPS},
    **{
        f"drake {kind}, {n} steps a frame": DrakeEngine(substeps=n, approximation=kind)
        for kind in ("lagged", "similar", "tamsi", "sap")
        for n in STEPS
    },
}
"""By words, what is compared with tossid's engine in 64 steps a frame."""


def distances(engine: Engine, reference: Engine, *, tosses: int, seed: int) -> np.ndarray:
    """(B,) mean distance of each toss over its frames [mm].

    Args:
        engine: The one.
        reference: The other.
        tosses: B.
        seed: Of the releases.
    """
    cube = load_object(OBJECT_FILES / "cube.xml")
    q, v = draw_releases(cube, ReleaseSettings(), tosses, gravity=GRAVITY, rng=np.random.default_rng(seed))
    one, other = (
        ENGINES[each.name].simulate(each, World(cube), q, v, n_steps=FRAMES, dt=1 / RATE).q[..., :3]
        for each in (engine, reference)
    )
    return np.asarray(1e3 * np.linalg.norm(one - other, axis=-1).mean(axis=1))


def rows(tosses: int, seed: int) -> Iterator[str]:
    """A line of a Markdown table an engine.

    Args:
        tosses: How many.
        seed: Of their releases.
    """
    for name, engine in OTHERS.items():
        try:
            far = distances(engine, LcpEngine(substeps=64), tosses=tosses, seed=seed)
        except ConfigError as missing:
            sys.stderr.write(f"{missing}\n")
            continue
        yield f"| {name} | {np.median(far):.1f} | {far.min():.1f} to {far.max():.1f} |"


def main() -> None:
    """Print the table."""
    given = dict(argument.split("=", 1) for argument in sys.argv[1:])
    print("| engine | median [mm] | least to most |\n|---|---|---|")  # noqa: T201
    for row in rows(int(given.get("tosses", "12")), int(given.get("seed", "5"))):
        print(row, flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
