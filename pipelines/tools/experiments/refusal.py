"""How often is what makes whole tosses worse refused, and what does not?

    python -m pipelines.tools.experiments.refusal [judges=24] [draws=8] [seed=8]

Tosses of a cube are made by known worlds, and predicted with effects that a diagnosis might have found: right ones,
right ones without what acts against them, and nearly nothing. One line a case has the mean errors without and with the
effects, the median growth over tosses, and in how many draws of so many judging tosses the effects are refused: at the
tolerances of the settings, and without any.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

import tossid
from tossid.audit.strengths import world_with
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.diagnosis.localisation.refusal import Growth
from tossid.diagnosis.localisation.rollouts import toss_errors
from tossid.physics.effects import World
from tossid.settings.diagnosis.diagnose import VerdictSettings
from tossid.settings.synthesis import LcpEngine, NoiseSettings

NOISE = NoiseSettings(position=1.5e-4, rotation=1.5e-3, velocity=0.03, spin=0.3)
Effects = dict[str, dict[str, float]]
_FRICTION: Effects = {"friction": {"mu": 0.2}}
CASES: dict[str, tuple[Effects, Effects]] = {
    "right": (_FRICTION, _FRICTION),
    "nearly nothing": ({}, {"friction": {"mu": 0.1805}}),
    "friction without its bounce": ({**_FRICTION, "restitution": {"e": 0.3}}, _FRICTION),
    "adhesion without a bounce of 0.3": (
        {"restitution": {"e": 0.3}, "adhesion": {"force_n": 0.5}},
        {"adhesion": {"force_n": 0.44}},
    ),
    "adhesion without a bounce of 0.2": (
        {"restitution": {"e": 0.2}, "adhesion": {"force_n": 1.0}},
        {"adhesion": {"force_n": 0.94}},
    ),
    "both": ({"restitution": {"e": 0.3}, "adhesion": {"force_n": 0.5}},) * 2,
}
"""By name, the effects of the tosses, and those that were found."""


def line(name: str, *, judges: int, draws: int, seed: int) -> str:
    """What becomes of one case.

    Args:
        name: Of the case.
        judges: Tosses that judge.
        draws: How many draws of them.
        seed: Of the tosses.
    """
    truth, found = CASES[name]
    dataset = tossid.synthesize(
        "cube", tosses=judges * draws, seed=seed, engine=LcpEngine(), effects=truth, noise=NOISE
    )
    stated, windows = World(dataset.object), make_windows(dataset.tosses, dataset.object)
    before, after = (
        toss_errors(dataset.tosses, world, windows, n_threads=1) for world in (stated, world_with(stated, found))
    )
    settings = VerdictSettings()
    without = replace(settings, matters_position_pct=0.0, matters_rotation_deg=0.0)
    parts = [slice(k * judges, (k + 1) * judges) for k in range(draws)]
    refused, strictly = (
        sum(Growth.of(after[part], before[part], settings.refused_level, each).refused for part in parts)
        for each in (settings, without)
    )
    means = [f"{x:.1f} %, {y:.1f}°" for x, y in (np.nanmean(each, axis=0).tolist() for each in (before, after))]
    whole = Growth.of(after, before, settings.refused_level)
    growth = f"{whole.position_pct:+.2f} %, {whole.rotation_deg:+.2f}°"
    return f"| {name} | {means[0]} | {means[1]} | {growth} | {refused} of {draws} | {strictly} of {draws} |"


def main(arguments: list[str]) -> None:
    """The lines of all cases, as a table in Markdown."""
    keys = {"judges": 24, "draws": 8, "seed": 8}
    keys |= {name: int(value) for name, value in (each.split("=", 1) for each in arguments)}
    sys.stdout.write(
        "| found | without | with | at the median | refused | without a tolerance |\n|---|---|---|---|---|---|\n"
    )
    for name in CASES:
        sys.stdout.write(line(name, **keys) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
