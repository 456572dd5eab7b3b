"""The diagnosis of tosses that were made with known effects, and on tosses without any.

python -m experiments.search.made_cases OUT.jsonl                       # the cases below
python -m experiments.search.made_cases OUT.jsonl --nulls 400 --tosses 16    # how often is something named by chance?
python -m experiments.search.made_cases OUT.jsonl --cases rebound centre --tosses 40
python -m experiments.search.made_cases OUT.jsonl --data CUBE.h5 --skip 0 40 80 --tosses 40 --judged  # training tosses
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.stats import binomtest

import tossid
from experiments.harness import Case, Line, markdown, measured, options, succeeded
from pipelines.cli.failures import guarded
from tossid.audit.making import TOSSES, record
from tossid.objects import load_object
from tossid.settings.audit import AuditSettings
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.settings.synthesis import LcpEngine, SynthesizeSettings
from tossid.store import Dataset, read_dataset
from tossid.synthesis.engines import ENGINES
from tossid.synthesis.tosses import make_tosses

Effects = Mapping[str, Mapping[str, float]]

CASES: dict[str, tuple[str, Effects]] = {
    "null": ("lcp", {}),
    "centre": ("lcp", {"com_offset": {"z_m": 0.005}}),
    "gravity": ("lcp", {"gravity": {"g_ms2": 10.1}}),
    "drag": ("lcp", {"linear_drag": {"c_nspm": 0.05}}),
    "spin_drag": ("lcp", {"spin_drag": {"c_nms": 5e-4}}),
    "magnus": ("lcp", {"magnus": {"c_ns2pm": 0.01}}),
    "friction": ("lcp", {"friction": {"mu": 0.26}}),
    "rebound": ("lcp", {"restitution": {"e": 0.25}}),
    "inertia": ("lcp", {"inertia": {"scale_rel": 1.3}}),
    "size": ("lcp", {"geometry": {"size_rel": 1.03}}),
    "tilt": ("lcp", {"ground_tilt": {"x_rad": 0.012, "y_rad": -0.01}}),
    "round": ("lcp", {"rounded_corners": {"radius_m": 0.006}}),
    "soft": ("lcp", {"compliance": {"stiffness_npm": 5e3, "damping_nspm": 15.0}}),
    "lengths": ("lcp", {"length_scale": {"scale_rel": 1.015}}),
    "cohesion": ("lcp", {"cohesion": {"c_n": 0.15}}),
    "delay": ("lcp", {"rotation_delay": {"delay_s": 0.003}}),
    "two_frictions": ("lcp", {"velocity_friction": {"static_mu": 0.26, "sliding_mu": 0.15, "speed_ms": 0.25}}),
    "centre_friction": ("lcp", {"com_offset": {"x_m": 0.003, "z_m": -0.003}, "friction": {"mu": 0.26}}),
    "rebound_drag": ("lcp", {"restitution": {"e": 0.25}, "linear_drag": {"c_nspm": 0.05}}),
    "gravity_inertia": ("lcp", {"gravity": {"g_ms2": 10.1}, "inertia": {"scale_rel": 1.3}}),
    "mujoco_null": ("mujoco", {}),
    "mujoco_friction": ("mujoco", {"friction": {"mu": 0.26}}),
    "mujoco_centre": ("mujoco", {"com_offset": {"z_m": 0.005}}),
    "mujoco_rebound": ("mujoco", {"restitution": {"e": 0.25}}),
    "four": (
        "lcp",
        {
            "gravity": {"g_ms2": 10.0},
            "friction": {"mu": 0.24},
            "restitution": {"e": 0.2},
            "inertia": {"scale_rel": 1.25},
        },
    ),
    "four_others": (
        "lcp",
        {
            "com_offset": {"x_m": 0.002, "z_m": 0.003},
            "linear_drag": {"c_nspm": 0.04},
            "geometry": {"size_rel": 1.02},
            "cohesion": {"c_n": 0.08},
        },
    ),
}
"""By name: the engine, and the effects that the stated cube lacks."""

SUBSTEPS = 32
"""Of the exact engine a frame, sixteen times as fine as the search simulates."""


def made(engine: str, effects: Effects, tosses: int, seed: int, noise: float = 1.5e-4) -> Dataset:
    """A dataset of tosses of the cube, with noise as a tracker has it, ingested from pose files.

    Args:
        engine: "lcp" or "mujoco".
        effects: What the stated cube lacks.
        tosses: How many.
        seed: Of throws and noise.
        noise: Of positions [m]; rotations have ten times as much [rad].
    """
    model, how = load_object("cube"), ENGINES[engine].settings()
    how = replace(how, substeps=SUBSTEPS) if isinstance(how, LcpEngine) else how
    settings = SynthesizeSettings(engine=how, tosses=tosses, effects={k: dict(v) for k, v in effects.items()})
    of_throws, of_noise = np.random.default_rng([seed, 5]).spawn(2)
    of_poses = AuditSettings(position_noise=noise, rotation_noise=10 * noise)
    with TemporaryDirectory() as folder:
        record(make_tosses(settings, model, of_throws)[0], model, of_poses, of_noise, Path(folder))
        return read_dataset(Path(folder) / TOSSES)


def diagnosed(case: Case, data: str) -> Line:
    """What a diagnosis of the nominal cube says.

    Args:
        case: Its name, its `seed` (of a dataset: how many training tosses are left out first), number of `tosses`, and
            `repeats` of the search.
        data: A dataset of recorded tosses; empty for made ones.
    """
    if data:
        recorded = read_dataset(Path(data))
        chosen = recorded.of_split("train")[case["seed"] : case["seed"] + case["tosses"]]
        truth, dataset = None, replace(recorded, tosses=chosen)
    else:
        engine, truth = CASES[case["case"]]
        dataset = made(engine, truth, case["tosses"], case["seed"])
    began = time.process_time()
    gap = tossid.diagnose(dataset, "nominal", repeats=case["repeats"], threads=1, tosses=len(dataset))
    before, after = gap.brings.position_pct()
    return {
        "truth": truth,
        "found": {f.name: {key: x.as_json() for key, x in f.parameters.items()} for f in gap.found},
        "verdict": gap.verdict,
        "minor": list(gap.minor),
        "alike": {f.name: list(f.confusable_with) for f in gap.found if f.confusable_with},
        "frequency": {f.name: f.frequency for f in gap.found} if case["repeats"] else None,
        "closed": gap.gap_closed.as_json() if case["repeats"] else None,
        "position_error_pct": [before.value, after.value],
        "seconds": round(time.process_time() - began, 2),
    }


def row(line: Line) -> list[str]:
    """A row of the table."""
    found = []
    for name, values in line["found"].items():
        how_often = "" if line["frequency"] is None else f" [{100 * line['frequency'][name]:.0f} %]"
        or_others = f" (or {', '.join(line['alike'][name])})" if name in line["alike"] else ""
        numbers = ", ".join(f"{x['value']:.4g}" for x in values.values())
        found.append(f"{name} {numbers}{how_often}{or_others}")
    closed = "" if line["closed"] is None else "{:.0f} %".format(100 * line["closed"]["value"])
    tosses = "{:.2g} → {:.2g}".format(*line["position_error_pct"])
    about = (line["case"], line["seed"], "; ".join(found) or "nothing", line["verdict"], closed, tosses)
    return [*map(str, about), f"{line['seconds']:.0f}"]


def summary(lines: Sequence[Line]) -> str:
    """How many made cases have the right names and no other, and how many intervals hold the truth."""
    known = [line for line in lines if line["truth"] is not None]
    right = sum(set(line["found"]) == set(line["truth"]) for line in known)
    held = [
        x["ci95"][0] <= line["truth"][name][key] <= x["ci95"][1]
        for line in known
        for name, values in line["found"].items()
        for key, x in values.items()
        if key in line["truth"].get(name, {}) and x["ci95"] is not None
    ]
    low, high = binomtest(len(known) - right, len(known)).proportion_ci() if known else (np.nan, np.nan)
    return (
        f"{right} of {len(known)} name what was made and nothing else (95 % of the share that does not: "
        f"{100 * low:.1f} to {100 * high:.1f} %); intervals hold {sum(held)} of {len(held)} parameters"
    )


def main(arguments: list[str]) -> None:
    """Make and diagnose the cases that OUT lacks, and print all that are asked for."""
    given = options(
        __doc__, arguments, out=Path, cases=tuple(CASES), tosses=20, nulls=0, seed=1, data="", skip=(0,), judged=False,
        processes=1,
    )  # fmt: skip
    asked = [(name, given.seed + k) for k, name in enumerate(given.cases)]
    if given.nulls:
        asked = [("null", given.seed + k) for k in range(given.nulls)]
    if given.data:
        asked = [(Path(given.data).stem, skip) for skip in given.skip]
    repeats = DiagnoseSettings().repeats if given.judged else 0
    cases = [{"case": name, "seed": seed, "tosses": given.tosses, "repeats": repeats} for name, seed in asked]
    measure = partial(diagnosed, data=given.data)
    lines = list(succeeded(measured(given.out, cases, measure, processes=given.processes)))
    heads = ("case", "seed", "found", "verdict", "closed", "whole tosses [%]", "CPU s")
    print(markdown(heads, map(row, lines)))
    print(summary(lines))


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(sys.argv[1:]), "made_cases"))
