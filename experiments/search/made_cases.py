"""The diagnosis of tosses that were made with known effects, and on tosses without any.

    python -m experiments.search.made_cases OUT.jsonl                       # the cases below
    python -m experiments.search.made_cases OUT.jsonl --nulls 400           # how often something is named by chance
    python -m experiments.search.made_cases OUT.jsonl --cases rebound centre --tosses 40
    python -m experiments.search.made_cases OUT.jsonl --data CUBE.h5 --skip 0 40 80 --tosses 40    # its train split

A line of JSON a case: what was made, what was found, seconds of processor time. Lines that are there are not made
again, so an interrupted run goes on. `docs/results/diagnosis.md` has the table.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from tossid.diagnosis.diagnose import diagnose
from tossid.ingestion.ingest import ingest_source
from tossid.objects import ObjectModel, load_object
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.settings.ingestion import IngestSettings
from tossid.settings.synthesis import LcpEngine, NoiseSettings, SynthesizeSettings
from tossid.store import Dataset, read_dataset, write_tum
from tossid.store.importers import TumSource
from tossid.synthesis.engines import ENGINES
from tossid.synthesis.tosses import add_noise, make_tosses

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

NOISE = NoiseSettings(position=1.5e-4, rotation=1.5e-3, joint=1.5e-3)
SUBSTEPS = 32
"""Of the exact engine a frame, sixteen times as fine as the search simulates."""


def made(
    model: ObjectModel, engine: str, effects: Effects, tosses: int, seed: int, noise: NoiseSettings = NOISE
) -> Dataset:
    """A dataset of made tosses, with noise as a tracker has it, ingested from pose files.

    Args:
        model: The stated object.
        engine: "lcp" or "mujoco".
        effects: What the stated object lacks.
        tosses: How many.
        seed: Of throws and noise.
        noise: Of the poses.
    """
    how = ENGINES[engine].settings()
    how = replace(how, substeps=SUBSTEPS) if isinstance(how, LcpEngine) else how
    settings = SynthesizeSettings(engine=how, tosses=tosses, effects={k: dict(v) for k, v in effects.items()})
    of_throws, of_noise = np.random.default_rng([seed, 5]).spawn(2)
    with TemporaryDirectory() as folder:
        out = Path(folder) / "tosses.h5"
        write_tum(Path(folder) / "tum", add_noise(make_tosses(settings, model, of_throws)[0], model, noise, of_noise))
        source = TumSource(path=Path(folder) / "tum")
        ingest_source(source, object=model, settings=IngestSettings(), out=out, progress=lambda done: None)
        return read_dataset(out)


def diagnosed(dataset: Dataset, *, judged: bool, threads: int) -> dict[str, Any]:
    """What a diagnosis of a dataset's nominal simulator says.

    Args:
        dataset: Of tosses.
        judged: Whether the search is repeated without parts of the tosses, which judge it.
        threads: Of simulators.
    """
    began, elapsed = time.process_time(), time.perf_counter()
    gap = diagnose(dataset, "nominal", repeats=FOLDS if judged else 0, threads=threads, tosses=len(dataset))
    before, after = gap.brings.position_pct()
    return {
        "law": gap.contact,
        "verdict": gap.verdict,
        "found": {f.name: {key: x.as_json() for key, x in f.parameters.items()} for f in gap.found},
        "effects": {f.name: f.verdict for f in gap.found},
        "minor": list(gap.minor),
        "alike": {f.name: list(f.confusable_with) for f in gap.found if f.confusable_with},
        "gain": {f.name: f.evidence["gain"] for f in gap.found},
        "frequency": {f.name: f.frequency for f in gap.found} if judged else None,
        "closed": gap.gap_closed.as_json() if judged else None,
        "position_error_pct": [before.value, after.value],
        "seconds": round(time.process_time() - began, 2),
        "elapsed": round(time.perf_counter() - elapsed, 2),
    }


FOLDS = DiagnoseSettings().repeats
"""Parts of the tosses that judge the search."""


def main() -> None:
    """Make what is missing of the asked cases."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--cases", nargs="*", default=list(CASES))
    parser.add_argument("--tosses", type=int, default=20)
    parser.add_argument("--nulls", type=int, default=0, help="so many draws of the case 'null' instead")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--data", type=Path, help="a dataset of recorded tosses instead")
    parser.add_argument("--skip", type=int, nargs="*", default=[0], help="its tosses before the first, of each search")
    parser.add_argument("--judged", action="store_true")
    parser.add_argument("--threads", type=int, default=1)
    given = parser.parse_args()
    asked = [(name, given.seed + k) for k, name in enumerate(given.cases)]
    if given.nulls:
        asked = [("null", given.seed + k) for k in range(given.nulls)]
    if given.data is not None:
        asked = [(given.data.stem, skip) for skip in given.skip]
    lines = given.out.read_text().splitlines() if given.out.exists() else []
    known = {(line["case"], line["seed"], line["tosses"]) for line in map(json.loads, lines)}
    model = load_object("cube")
    for name, seed in asked:
        if (name, seed, given.tosses) in known:
            continue
        engine, effects = CASES.get(name, ("recorded", {}))
        if given.data is None:
            dataset = made(model, engine, effects, given.tosses, seed)
        else:
            recorded = read_dataset(given.data)
            chosen = recorded.of_split("train")[seed : seed + given.tosses]
            dataset = replace(recorded, tosses=chosen)
        line = {"case": name, "seed": seed, "tosses": given.tosses, "truth": effects}
        line |= diagnosed(dataset, judged=given.judged, threads=given.threads)
        with given.out.open("a") as file:
            file.write(json.dumps(line) + "\n")
        print(f"{name} {seed}: {line['found']} ({line['seconds']} s)", file=sys.stderr)


if __name__ == "__main__":
    main()
