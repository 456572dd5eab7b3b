"""A user's MuJoCo model as people have it, diagnosed: soft contact, a pyramidal cone, 2 ms, and another friction.

    python -m experiments.search.mujoco_models OUT.jsonl                     # twelve cases
    python -m experiments.search.mujoco_models OUT.jsonl --cases 6 --noise 1e-5

A case draws what the real cube has and the model lacks, makes tosses of it in an engine with rigid contact, and
searches over half of them. The other half judges: whole tosses in plain MuJoCo, by the user's file, by its patch, and
by that of the true effects, beyond which only another engine could go.
"""

from __future__ import annotations

import sys
import time
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from experiments.harness import Case, Line, markdown, measured, options, succeeded
from experiments.search.made_cases import made
from pipelines.cli.failures import guarded
from tossid.diagnosis.inference.hypothesis import COULOMB, Hypothesis
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.inference.search import Search
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.diagnosis.localisation.rollouts import distances
from tossid.diagnosis.patch.rerun import runs_in_mujoco
from tossid.diagnosis.simulators import read_simulator
from tossid.motion.resting import rest_scatter
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
ENGINES = ("lcp", "mujoco")
WHEN = ("before", "after", "by the truth")
KINDS = ("friction", "inertia", "centre", "none")
TOSSES = 16
"""That are searched, and as many that judge."""


def drawn(case: int) -> tuple[str, dict[str, dict[str, float]]]:
    """The engine that makes a case's tosses, and what the real cube has beside the model.

    Args:
        case: Its number.
    """
    rng, kind = np.random.default_rng([case, 17]), KINDS[case % len(KINDS)]
    engine = ENGINES[case // len(KINDS) % 2]
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


def searched(case: Case, threads: int) -> Line:
    """What is found of a case, and what the patch brings in plain MuJoCo for tosses that took no part.

    Args:
        case: Its number, and the `noise` of positions [m].
        threads: Of simulators.
    """
    engine, truth = drawn(case["case"])
    dataset = made(engine, truth, 2 * TOSSES, case["case"], case["noise"])
    tosses, model = dataset.tosses, dataset.object
    windows = make_windows(tosses, model, scatter=rest_scatter(tosses, model))
    part = [Sample(windows.of_tosses(np.arange(TOSSES) + at), TOSSES, threads) for at in (0, TOSSES)]
    library = {effect.name: effect for effect in effects_for(model)}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "cube.xml"
        path.write_text(MODEL)
        simulator = read_simulator(path, model)
        stated = Hypothesis(simulator.world, simulator.law)
        began = time.process_time()
        found = Search(part[0], tuple(library.values()), stated, simulator.laws).run().hypothesis
        seconds = time.process_time() - began
        true = Hypothesis(simulator.world, COULOMB)
        for name, values in truth.items():
            true = true.plus(library[name], library[name].values_with(true.world(), values))
        runs, others = runs_in_mujoco(path), tosses[TOSSES:]
        recorded = [toss.q for toss in others]
        errors = [distances(runs(h, others, part[1]), recorded, model.width) for h in (stated, found, true)]
    return {
        "engine": engine,
        "truth": truth,
        "law": found.law.name,
        "found": {effect.name: effect.named(values) for effect, values in found.items()},
        **{when: np.nanmean(each, axis=0).tolist() for when, each in zip(WHEN, errors, strict=True)},
        "seconds": round(seconds, 1),
    }


def main(arguments: list[str]) -> None:
    """Make the cases that OUT lacks, and print them and the medians of what the patches close."""
    given = options(__doc__, arguments, out=Path, cases=12, noise=1.5e-4, threads=1, processes=1)
    cases = [{"case": case, "noise": given.noise} for case in range(given.cases)]
    measure = partial(searched, threads=given.threads)
    lines = list(succeeded(measured(given.out, cases, measure, processes=given.processes)))
    heads = ("case", "tosses by", "true", "found", "law", *(f"{when} [%], [deg]" for when in WHEN), "CPU s")
    rows = []
    for line in lines:
        names = (", ".join(line[key]) or "nothing" for key in ("truth", "found"))
        errors = ("{:.2f}, {:.1f}".format(*line[when]) for when in WHEN)
        rows.append([line["case"], line["engine"], *names, line["law"], *errors, line["seconds"]])
    print(markdown(heads, rows))
    for engine in ENGINES:
        some = [line for line in lines if line["engine"] == engine]
        right = sum(set(line["found"]) == set(line["truth"]) for line in some)
        closed = [np.median([1 - x[when][0] / x["before"][0] for x in some] or [np.nan]) for when in WHEN[1:]]
        print(f"{engine}: names right in {right} of {len(some)}, closed {closed[0]:.1%}; by the truth {closed[1]:.1%}")


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(sys.argv[1:]), "mujoco_models"))
