"""Does a diagnosis of a user's simulator name what was changed in it?

    python -m experiments.users_simulator OUT.jsonl --engine mujoco --cases null friction+

Tosses are made by an engine that has one effect, with noise, and the user's simulator is that engine without it:
tossid's own, MuJoCo with its default soft contact, Bullet or Drake. `null` is the engine itself. A row has what was
named with 95 % intervals, the gap, the share of it that is closed, and how often the simulator was asked for each
window.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import tossid
from experiments.harness import Case, Line, markdown, measured, options, succeeded
from pipelines.cli.failures import guarded
from tossid.diagnosis.likelihood.simulator_process import BatchFunction
from tossid.physics import simulate
from tossid.physics.effects import World
from tossid.physics.effects.in_mujoco import toss_in_mujoco
from tossid.settings.synthesis import BulletEngine, DrakeEngine, Engine, LcpEngine, MujocoEngine, NoiseSettings
from tossid.synthesis.foreign_engines import SCENES, Scene

Array = NDArray[np.float64]

ENGINES: Mapping[str, Engine] = {
    "lcp": LcpEngine(substeps=32),
    "mujoco": MujocoEngine(soft=True),
    "bullet": BulletEngine(),
    "drake": DrakeEngine(),
}
NOISE = NoiseSettings(position=1.5e-4, rotation=1.5e-3, velocity=0.03, spin=0.3)
CASES: dict[str, dict[str, dict[str, float]]] = {
    "null": {},
    "gravity-": {"gravity": {"g_ms2": 9.2}},
    "gravity+": {"gravity": {"g_ms2": 10.3}},
    "friction+": {"friction": {"mu": 0.3}},
    "friction-": {"friction": {"mu": 0.12}},
    "friction++": {"friction": {"mu": 0.22}},
    "com_x": {"com_offset": {"x_m": 0.004, "y_m": 0.0, "z_m": 0.0}},
    "com": {"com_offset": {"x_m": 0.002, "y_m": -0.003, "z_m": 0.002}},
    "inertia+": {"inertia": {"scale_rel": 1.3}},
    "inertia-": {"inertia": {"scale_rel": 0.75}},
    "drag": {"quadratic_drag": {"c_ns2pm2": 0.02}},
    "force": {"uniform_force": {"x_n": 0.06, "y_n": 0.03}},
    "tilt": {"ground_tilt": {"x_rad": 0.02, "y_rad": 0.01}},
    "height": {"ground_height": {"z_m": 0.004}},
    "size": {"geometry": {"size_rel": 1.02}},
    "wind": {"wind": {"x_ms": 2.0, "y_ms": 0.0, "c_nspm": 0.02}},
    "torsional": {"torsional_friction": {"radius_m": 0.02}},
    "rolling": {"rolling_resistance": {"radius_m": 0.003}},
    "length": {"length_scale": {"scale_rel": 0.985}},
    "clock": {"time_base": {"rate_rel": 1.01}},
    "magnus": {"magnus": {"c_ns2pm": 0.01}},
}
"""By name, the engine's effects with their values."""


HEADS = ("case", "truth", "named (95 %)", "cannot be told from", "gap [sd]", "closed [%]", "passes", "CPU s")


def users_function(engine: Engine, stated: World) -> BatchFunction:
    """An engine of the stated object, as a user would hand it over.

    Args:
        engine: Its settings.
        stated: The object.
    """

    @lru_cache
    def scene() -> Scene:  # made by the first call, in the process that calls
        return SCENES[engine.name](engine, stated)

    def call(q0: Array, v0: Array, n_steps: int, dt: float) -> tuple[Array, Array]:
        if isinstance(engine, LcpEngine):
            done = simulate(stated.system(), q0, v0, n_steps=n_steps, dt=dt, substeps=engine.substeps)
            return done.q, done.v
        if isinstance(engine, MujocoEngine):
            return toss_in_mujoco(stated, q0, v0, n_steps, dt, substeps=engine.substeps, soft=engine.soft)
        return scene().toss(q0, v0, n_steps=n_steps, dt=dt)

    return call


def named(case: Case, engine: Engine, without: tuple[str, ...] = ()) -> Line:
    """What is named in a case.

    Args:
        case: Its name, how many `tosses` and `repeats`, and the `seed`; each case has tosses of its own.
        engine: What makes the tosses.
        without: Effects that are not sought.
    """
    effects, seed = CASES[case["case"]], case["seed"] + 100 * list(CASES).index(case["case"])
    dataset = tossid.synthesize("cube", tosses=case["tosses"], seed=seed, engine=engine, effects=effects, noise=NOISE)
    began = time.process_time()
    function = users_function(engine, World(dataset.object))
    found = tossid.diagnose(dataset, function, repeats=case["repeats"], threads=1, without=without)
    return {
        "truth": effects,
        "named": list(found.named),
        "classes": {finding.name: list(finding.confusable_with) for finding in found.found},
        "verdict": found.verdict,
        "values": {
            f"{finding.name}.{parameter}": [value.value, value.low, value.high]
            for finding in found.found
            for parameter, value in finding.parameters.items()
        },
        "gap": found.gap.total.as_json(),
        "closed": found.gap_closed.as_json(),
        "passes": found.passes,
        "cpu_s": time.process_time() - began,
    }


def row(line: Line) -> list[str]:
    """A row of the table of `HEADS`."""
    truth = ", ".join(f"{name} {x:g}" for values in line["truth"].values() for name, x in values.items())
    values = [f"{name} {x:.4g} ({low:.4g} to {high:.4g})" for name, (x, low, high) in line["values"].items()]
    others = ", ".join(other for each in line["named"] for other in line["classes"][each])
    low, high = (f"{100 * end:.0f}" for end in line["closed"]["ci95"])
    figures = [f"{line['gap']['value']:.2f}", f"{100 * line['closed']['value']:.1f} ({low} to {high})"]
    answer = "; ".join(values) or "nothing"
    return [line["case"], truth, answer, others, *figures, f"{line['passes'] or 0:.0f}", f"{line['cpu_s']:.0f}"]


def summary(lines: list[Line]) -> str:
    """What the cases come to."""
    changed = [line for line in lines if line["truth"]]
    right = sum(line["named"][:1] == list(line["truth"]) for line in changed)
    further = sum(bool(set(line["named"]) - set(line["truth"])) for line in lines)
    closed = sum(line["closed"]["value"] >= 0.95 for line in changed)
    return (
        f"{right} of {len(changed)} have the right name first, {further} have further names, {closed} close 95 % of "
        "the gap."
    )


def main(arguments: list[str]) -> None:
    """Diagnose the cases that OUT lacks, and print all that are asked for; a case that the engine lacks is said."""
    given = options(
        __doc__, arguments, out=Path, engine="mujoco", cases=tuple(CASES), tosses=16, seed=1, repeats=0, processes=1
    )
    about = {"engine": given.engine, "tosses": given.tosses, "seed": given.seed, "repeats": given.repeats}
    cases = [{"case": name, **about} for name in given.cases]
    measure = partial(named, engine=ENGINES[given.engine])
    lines = list(succeeded(measured(given.out, cases, measure, processes=given.processes)))
    print(markdown(HEADS, map(row, lines)))
    print(summary(lines))


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(sys.argv[1:]), "users_simulator"))
