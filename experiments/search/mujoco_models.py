"""A user's MuJoCo model as people have it, diagnosed: soft contact, a pyramidal cone, 2 ms, and another friction.

    python -m experiments.search.mujoco_models OUT.jsonl                     # twenty cases
    python -m experiments.search.mujoco_models OUT.jsonl --cases 6 --noise 1e-5
    python -m experiments.search.mujoco_models OUT.jsonl --cases 0           # the table of what is there

A case draws what the real cube has and the model lacks, makes tosses of it in an engine with rigid contact, and
searches over half of them. The other half judges: whole tosses in plain MuJoCo, by the user's file, by its patch, and
by that of the true effects, beyond which only another engine could go. A line of JSON a case; lines that are there are
not made again.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from experiments.search.made_cases import NOISE, made
from tossid.diagnosis.inference.hypothesis import COULOMB, Hypothesis
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.inference.search import Search
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.diagnosis.localisation.rollouts import distances
from tossid.diagnosis.patch.rerun import runs_in_mujoco
from tossid.diagnosis.simulators import read_simulator
from tossid.motion.resting import rest_scatter
from tossid.objects import load_object
from tossid.physics.effects import effects_for

MODEL = """<mujoco model="my cube">
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1" friction="0.1 0.005 0.0001"/>
    <body name="cube" pos="0 0 0.3">
      <freejoint/>
      <inertial pos="0 0 0" mass="0.37" diaginertia="0.00081 0.00081 0.00081"/>
      <geom type="box" size="0.0524 0.0524 0.0524" friction="0.18 0.005 0.0001"/>
    </body>
  </worldbody>
</mujoco>
"""
KINDS = ("friction", "inertia", "centre", "none")
TOSSES = 16
"""That are searched, and as many that judge."""


def drawn(case: int) -> tuple[str, dict[str, dict[str, float]]]:
    """The engine that makes a case's tosses, and what the real cube has beside the model.

    Args:
        case: Its number.
    """
    rng, kind = np.random.default_rng([case, 17]), KINDS[case % len(KINDS)]
    engine = ("lcp", "mujoco")[case // len(KINDS) % 2]
    if kind == "none":
        return engine, {}
    effects = {"friction": {"mu": float(rng.uniform(0.23, 0.33))}}
    if kind == "inertia":
        effects["inertia"] = {"scale_rel": float(rng.uniform(1.2, 1.4))}
    if kind == "centre":
        place = rng.normal(size=3)
        place *= 0.005 / np.linalg.norm(place)
        effects["com_offset"] = dict(zip(("x_m", "y_m", "z_m"), place.tolist(), strict=True))
    return engine, effects


def searched(case: int, *, noise: float, threads: int) -> dict[str, Any]:
    """What is found of a case, and what the patch brings in plain MuJoCo for tosses that took no part.

    Args:
        case: Its number.
        noise: Of positions [m].
        threads: Of simulators.
    """
    engine, truth = drawn(case)
    of_poses = replace(NOISE, position=noise, rotation=noise * NOISE.rotation / NOISE.position)
    dataset = made(load_object("cube"), engine, truth, 2 * TOSSES, case, of_poses)
    tosses, model = dataset.tosses, dataset.object
    windows = make_windows(tosses, model, scatter=rest_scatter(tosses, model))
    part = [Sample(windows.of_tosses(np.arange(TOSSES) + at), TOSSES, threads) for at in (0, TOSSES)]
    library = {effect.name: effect for effect in effects_for(model)}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "cube.xml"
        path.write_text(MODEL)
        simulator = read_simulator(path, model)
        stated = Hypothesis(simulator.world, simulator.law)
        begun = time.perf_counter()
        found = Search(part[0], tuple(library.values()), stated, simulator.laws).run().hypothesis
        seconds = time.perf_counter() - begun
        true = Hypothesis(simulator.world, COULOMB)
        for name, values in truth.items():
            true = true.plus(library[name], library[name].values_with(true.world(), values))
        runs, others = runs_in_mujoco(path), tosses[TOSSES:]
        recorded = [toss.q for toss in others]
        errors = [distances(runs(h, others, part[1]), recorded, model.width) for h in (stated, found, true)]
        before, after, best = (np.nanmean(each, axis=0).tolist() for each in errors)
    return {
        "case": case,
        "noise": noise,
        "engine": engine,
        "truth": truth,
        "law": found.law.name,
        "found": {effect.name: effect.named(values) for effect, values in found.items()},
        "before": before,
        "after": after,
        "best": best,
        "seconds": round(seconds, 1),
    }


def table(lines: list[dict[str, Any]]) -> str:
    """The cases in words, and the medians of what the patches close.

    Args:
        lines: Of the cases.
    """
    out = []
    for line in lines:
        errors = " to ".join("{:.2f} % {:.1f} deg".format(*line[when]) for when in ("before", "after"))
        names = ", ".join(line["found"]) or "nothing"
        best = "{:.2f} % {:.1f} deg".format(*line["best"])
        out.append(f"{line['case']:3d} {line['engine']:6s} {line['law']:8s} {errors} (truth {best}): {names}")
    for engine in ("lcp", "mujoco"):
        some = [line for line in lines if line["engine"] == engine]
        right = sum(set(line["found"]) == set(line["truth"]) for line in some)
        closed = [np.median([1 - x[when][0] / x["before"][0] for x in some] or [np.nan]) for when in ("after", "best")]
        out.append(
            f"{engine}: names right in {right} of {len(some)}, closed {closed[0]:.1%}; by the truth {closed[1]:.1%}"
        )
    return "\n".join(out)


def main() -> None:
    """Make what is missing of the asked cases."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--noise", type=float, default=NOISE.position, help="of positions [m]; rotations in proportion")
    parser.add_argument("--threads", type=int, default=1)
    given = parser.parse_args()
    lines = [json.loads(line) for line in given.out.read_text().splitlines()] if given.out.exists() else []
    known = {(line["case"], line["noise"]) for line in lines}
    for case in range(given.cases):
        if (case, given.noise) in known:
            continue
        lines.append(searched(case, noise=given.noise, threads=given.threads))
        with given.out.open("a") as file:
            file.write(json.dumps(lines[-1]) + "\n")
        print(json.dumps(lines[-1]), file=sys.stderr)
    print(table([line for line in lines if line["noise"] == given.noise]))


if __name__ == "__main__":
    main()
