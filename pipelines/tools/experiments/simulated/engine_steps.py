"""How far engines are from tossid's own on the same releases, by their time steps and approximations.

    python -m pipelines.tools.experiments.simulated.engine_steps [tosses=12] [seed=5]

A row an engine: the median over tosses of the mean distance over 75 frames [mm], and its range. Then the median of
distances three frames after the first impact [mm] to tossid's engine under each of three laws: friction of an impact
against the slip after it, against the slip as it turns meanwhile (Routh's law), and the relaxation of the first.
Engines that are not installed are left out. Contact turns small differences into large ones, so two right solvers of
one rigid body differ here too.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np

from tossid.diagnosis.inference.hypothesis import RELAXED, ROUTH
from tossid.errors import ConfigError
from tossid.objects import GRAVITY, OBJECT_FILES, load_object
from tossid.physics.effects import World
from tossid.physics.forces import Law
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
JUMP = 0.2
"""Change of the vertical velocity in a frame, beyond gravity's, that is an impact [m/s]."""
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


AFTER = 3
"""Frames after the first impact."""
LAWS = {
    "after it": Law(),
    "as it turns": Law(impulse_parts=ROUTH.impulse_parts),
    "relaxed": Law(lifting=RELAXED.lifting),
}
"""Of contact, by what friction of an impact is against."""


def motions(engine: Engine, tosses: int, seed: int, law: Law = Law()) -> np.ndarray:
    """(B, T + 1, 7) poses of releases in an engine.

    Args:
        engine: The one.
        tosses: B.
        seed: Of the releases.
        law: Of contact, in tossid's own.
    """
    cube = load_object(OBJECT_FILES / "cube.xml")
    q, v = draw_releases(cube, ReleaseSettings(), tosses, gravity=GRAVITY, rng=np.random.default_rng(seed))
    run = ENGINES[engine.name].simulate(engine, World(cube, law=law), q, v, n_steps=FRAMES, dt=1 / RATE)
    return np.asarray(run.q)


def distances(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(B,) mean distance of each toss over its frames [mm].

    Args:
        one: (B, T + 1, 7) poses in an engine.
        other: The same in another.
    """
    return np.asarray(1e3 * np.linalg.norm(one[..., :3] - other[..., :3], axis=-1).mean(axis=1))


def after_impact(one: np.ndarray, other: np.ndarray) -> float:
    """Median distance some frames after each toss's first impact [mm].

    Args:
        one: (B, T + 1, 7) poses in an engine.
        other: The same in another, whose impact it is.
    """
    falls = np.diff(other[..., 2], n=2, axis=1) * RATE  # change of the vertical velocity in a frame
    impact = np.argmax(falls + GRAVITY / RATE > JUMP, axis=1) + 1
    row = np.arange(len(other)), np.minimum(impact + AFTER, other.shape[1] - 1)
    return float(1e3 * np.median(np.linalg.norm(one[row][:, :3] - other[row][:, :3], axis=1)))


def rows(tosses: int, seed: int) -> Iterator[str]:
    """A line of a Markdown table an engine.

    Args:
        tosses: How many.
        seed: Of their releases.
    """
    own = [motions(LcpEngine(substeps=64), tosses, seed, law) for law in LAWS.values()]
    for name, engine in OTHERS.items():
        try:
            run = motions(engine, tosses, seed)
        except ConfigError as missing:
            sys.stderr.write(f"{missing}\n")
            continue
        far = distances(run, own[0])
        beside = " | ".join(f"{after_impact(run, each):.2f}" for each in own)
        yield f"| {name} | {np.median(far):.1f} | {far.min():.1f} to {far.max():.1f} | {beside} |"


def main() -> None:
    """Print the table."""
    given = dict(argument.split("=", 1) for argument in sys.argv[1:])
    laws = " | ".join(f"after an impact, {name} [mm]" for name in LAWS)
    print(f"| engine | median [mm] | least to most | {laws} |\n" + "|---" * (3 + len(LAWS)) + "|")  # noqa: T201
    for row in rows(int(given.get("tosses", "12")), int(given.get("seed", "5"))):
        print(row, flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
