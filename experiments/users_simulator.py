"""Does a diagnosis of a user's simulator name what was changed in it?

    python -m experiments.users_simulator out=LINES.jsonl [engine=mujoco] [substeps=4]
        [tosses=16] [seed=1] [repeats=0] [without=...] [CASE ...]
    python -m experiments.users_simulator table=LINES.jsonl

Tosses are made by an engine that has one effect, with noise, and the user's simulator is that engine without it: MuJoCo
with its default soft contact, Bullet or Drake. One JSON line a case is added to the file: what was named, values with
95 % intervals, the gap, the share of it that is closed on tosses that took no part, and the CPU seconds of both
processes. Cases that the file has already are not run again. Without the names of cases all run that the engine has.
`null` is the engine itself. `substeps` are MuJoCo's steps a frame, 7 by default. `without` names effects that are not
sought. `table` prints a file in Markdown.
"""

from __future__ import annotations

import json
import math
import resource
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

import tossid
from tossid.diagnosis.likelihood.simulator_process import BatchFunction
from tossid.diagnosis.likelihood.users_world import UsersWorld
from tossid.diagnosis.result import Diagnosis
from tossid.diagnosis.simulators import users_simulator
from tossid.errors import ConfigError
from tossid.physics.effects import World
from tossid.physics.effects.in_mujoco import DEFAULT_STEP, scene, toss_in_mujoco
from tossid.settings.synthesis import (
    BulletEngine,
    DrakeEngine,
    Engine,
    MujocoEngine,
    NoiseSettings,
)
from tossid.synthesis.foreign_engines import SCENES

Array = NDArray[np.float64]

ENGINES: dict[str, Engine] = {"mujoco": MujocoEngine(soft=True), "bullet": BulletEngine(), "drake": DrakeEngine()}
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


def _found(case: Mapping[str, Mapping[str, float]], diagnosis: Diagnosis) -> dict[str, Any]:
    """What a case's line says."""
    found = {finding.name: finding for finding in diagnosis.found}
    return {
        "named": list(diagnosis.named),
        "minor": list(diagnosis.minor),
        "classes": {name: list(finding.confusable_with) for name, finding in found.items()},
        "right": diagnosis.named[:1] == tuple(case),
        "extra": len([name for name in diagnosis.named if name not in case]),
        "verdict": diagnosis.verdict,
        "values": {
            f"{name}.{parameter}": [value.value, value.low, value.high]
            for name, finding in found.items()
            for parameter, value in finding.parameters.items()
        },
        "gap": diagnosis.gap.total.as_json(),
        "left": diagnosis.left.total.as_json(),
        "closed": diagnosis.gap_closed.as_json(),
    }


def users_function(engine: Engine, stated: World) -> BatchFunction:
    """An engine of the stated object, as a user would hand it over.

    Args:
        engine: Its settings.
        stated: The object.
    """
    if not isinstance(engine, MujocoEngine):
        # made by the first call, in the process that calls
        made = lru_cache(partial(SCENES[engine.name], engine, stated))

        def other(q0: Array, v0: Array, n_steps: int, dt: float) -> tuple[Array, Array]:
            q, v = made().toss(q0, v0, n_steps=n_steps, dt=dt)
            return q, v

        return other
    stated_steps = engine.substeps

    @lru_cache
    def compiled(step: float) -> tuple[mujoco.MjModel, list[mujoco.MjData]]:
        model = scene(stated, step, soft=True)
        return model, [mujoco.MjData(model)]

    def soft_mujoco(q0: Array, v0: Array, n_steps: int, dt: float) -> tuple[Array, Array]:
        if stated.has_forces:
            return toss_in_mujoco(stated, q0, v0, n_steps, dt, substeps=stated_steps, soft=True)
        # MuJoCo's pool of threads, as engines use it, does not outlive the fork of this process
        substeps = stated_steps or math.ceil(dt / DEFAULT_STEP)
        model, data = compiled(dt / substeps)
        start = np.concatenate([np.zeros((len(q0), 1)), q0, v0], axis=1)
        states, _ = rollout.rollout(model, data, start, nstep=n_steps * substeps, persistent_pool=False)
        frames = np.concatenate([start[:, None], np.asarray(states)[:, substeps - 1 :: substeps]], axis=1)
        q, v = frames[..., 1 : 1 + model.nq], frames[..., 1 + model.nq :]
        q[..., 3:7] /= np.linalg.norm(q[..., 3:7], axis=-1, keepdims=True)
        return q, v

    return soft_mujoco


def run(
    engine: Engine, name: str, *, tosses: int, seed: int, repeats: int, without: tuple[str, ...] = ()
) -> dict[str, Any]:
    """The line of one case.

    Args:
        engine: Its settings.
        name: Of the case.
        tosses: How many are made.
        seed: Of the tosses; each case has tosses of its own.
        repeats: Of the search.
        without: Effects that are not sought.
    """
    effects, seed = CASES[name], seed + 100 * list(CASES).index(name)
    try:
        dataset = tossid.synthesize("cube", tosses=tosses, seed=seed, engine=engine, effects=effects, noise=NOISE)
    except ConfigError as error:
        return {"case": name, "left_out": str(error)}
    source, began = users_function(engine, World(dataset.object)), (time.process_time(), _of_children())
    simulator = users_simulator(source, dataset.object, about=f"{engine.name} without the effect")
    found = tossid.diagnose(dataset, simulator, repeats=repeats, threads=1, without=without)
    assert isinstance(simulator.world, UsersWorld)
    simulator.world.motions.process.close()
    seconds = {"cpu_s": time.process_time() - began[0], "simulator_cpu_s": _of_children() - began[1]}
    rounded = {name: round(value, 1) for name, value in seconds.items()}
    return {"case": name, "tosses": tosses, "seed": seed, "effects": effects, **_found(effects, found), **rounded}


def _of_children() -> float:
    """CPU time of processes that have ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def table(lines: list[dict[str, Any]]) -> str:
    """The lines of cases in Markdown, and what they come to.

    Args:
        lines: As `run` makes them.
    """
    rows = [
        "| truth | named (95 %) | cannot be told from | gap [sd] | closed [%] | CPU [s] |",
        "|---|---|---|---|---|---|",
    ]
    made = [line for line in lines if "named" in line]
    for line in made:
        values: dict[str, list[str]] = {}
        for key, (value, low, high) in line["values"].items():
            effect, parameter = key.split(".")
            values.setdefault(effect, []).append(f"{parameter} {value:.4g} ({low:.4g} to {high:.4g})")
        named = "; ".join(f"{each}: {', '.join(values[each])}" for each in line["named"]) or "nothing"
        others = ", ".join(other for each in line["named"] for other in line["classes"][each])
        truth = ", ".join(f"{p} {x:g}" for parameters in line["effects"].values() for p, x in parameters.items())
        closed = " to ".join(f"{100 * end:.0f}" for end in line["closed"]["ci95"])
        rows.append(
            f"| {', '.join(line['effects']) or 'nothing'} {truth} | {named} | {others} | {line['gap']['value']:.2f} | "
            f"{100 * line['closed']['value']:.1f} ({closed}) | {line['cpu_s'] + line['simulator_cpu_s']:.0f} |"
        )
    changed = [line for line in made if line["effects"]]
    total = (
        f"{sum(line['right'] for line in changed)} of {len(changed)} have the right name first, "
        f"{sum(line['extra'] > 0 for line in made)} have further names, "
        f"{sum(line['closed']['value'] >= 0.95 for line in changed)} close 95 % of the gap."
    )
    return "\n".join([*rows, "", total])


def read_lines(path: Path) -> list[dict[str, Any]]:
    """The cases of a file; none if it is not there yet."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def main(arguments: list[str]) -> None:
    """Run the cases that are not in the file yet, or print the table of a file."""
    keys = dict(each.split("=", 1) for each in arguments if "=" in each)
    names = [each for each in arguments if "=" not in each] or list(CASES)
    engine = ENGINES[keys.get("engine", "mujoco")]
    if "substeps" in keys:
        engine = replace(engine, substeps=int(keys["substeps"]))
    if "table" in keys:
        print(table(read_lines(Path(keys["table"]))))
        return
    out = Path(keys["out"])
    done = [line["case"] for line in read_lines(out)]
    for name in (each for each in names if each not in done):
        line = run(
            engine,
            name,
            tosses=int(keys.get("tosses", 16)),
            seed=int(keys.get("seed", 1)),
            repeats=int(keys.get("repeats", 0)),
            without=tuple(filter(None, keys.get("without", "").split(","))),
        )
        with out.open("a") as file:
            file.write(json.dumps(line) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
