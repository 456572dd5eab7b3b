"""Does a diagnosis of a user's simulator name what was changed in it?

    python -m experiments.users_simulator out=LINES.jsonl [engine=mujoco] [substeps=4]
        [tosses=16] [seed=1] [repeats=0] [without=...] [CASE ...]
    python -m experiments.users_simulator table=LINES.jsonl
    python -m experiments.users_simulator residuals=true [substeps=4] [tosses=16] [seed=1] [CASE ...]
    python -m experiments.users_simulator predict=true [engine=mujoco] [tosses=16] [seed=1] [CASE ...]

Tosses are made by an engine that has one effect, with noise, and the user's simulator is that engine without it: MuJoCo
with its default soft contact, Bullet or Drake. One JSON line a case is added to the file: what was named, values with
95 % intervals, the gap, the share of it that is closed on tosses that took no part, and the CPU seconds of both
processes. Cases that the file has already are not run again. Without the names of cases all run that the engine has.
`null` is the engine itself. `substeps` are MuJoCo's steps a frame, 7 by default. `without` names effects that are not
sought. `table` prints a file in Markdown.

With `residuals` nothing is sought either. A line has the root mean square of whitened residuals, by how often windows
that fit poorly are restarted: under the engine that made the tosses, and under the other with the true effect.

With `predict` nothing is sought. Windows of 20 frames are predicted from true first states, with the true effect, by
each form of `UsersWorld`: changes of whole motions, changes of frames by rigid contact, and by the nearest one. A line
has the median error over windows in standard deviations of noise, and the share of the mean square that is closed
(errors beyond 30 count as 30).
"""

from __future__ import annotations

import json
import math
import resource
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

import tossid
from pipelines.files.json_lines import add_line, lines_so_far, read_lines
from tossid.audit.strengths import world_with
from tossid.diagnosis.likelihood.simulator_process import BatchFunction, Given, SimulatorProcess
from tossid.diagnosis.likelihood.states import difference
from tossid.diagnosis.likelihood.step_changes import State
from tossid.diagnosis.likelihood.users_world import UsersWorld
from tossid.diagnosis.likelihood.whitening import linearised
from tossid.diagnosis.likelihood.windows import make_windows, steps_of
from tossid.diagnosis.result import Diagnosis
from tossid.diagnosis.simulators import users_simulator
from tossid.errors import ConfigError
from tossid.objects import load_object
from tossid.physics.effects import RecordingErrors, World
from tossid.physics.effects.in_mujoco import DEFAULT_STEP, scene, toss_in_mujoco
from tossid.settings.synthesis import (
    BulletEngine,
    DrakeEngine,
    Engine,
    MujocoEngine,
    NoiseSettings,
    ReleaseSettings,
    SynthesizeSettings,
)
from tossid.synthesis.foreign_engines import SCENES
from tossid.synthesis.tosses import draw_releases, world_of

Array = NDArray[np.float64]

ENGINES: dict[str, Engine] = {"mujoco": MujocoEngine(soft=True), "bullet": BulletEngine(), "drake": DrakeEngine()}
DT, SECONDS, WINDOW = 1 / 148, 0.5, 20
"""Of predictions: a frame [s], a toss [s], and frames of a window."""
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
    source, began = Given(users_function(engine, World(dataset.object))), (time.process_time(), _of_children())
    simulator = users_simulator(source, dataset.object, about=f"{engine.name} without the effect")
    found = tossid.diagnose(dataset, simulator, repeats=repeats, threads=1, without=without)
    assert isinstance(simulator.world, UsersWorld)
    assert simulator.world.motions is not None
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


def predict(engine: Engine, names: list[str], *, tosses: int, seed: int) -> Iterator[dict[str, Any]]:
    """One line a case: how well the true effect is predicted on top of the engine without it."""
    model = load_object("cube")
    stated, how = World(model), steps_of(World(model))
    users = UsersWorld.of(stated, SimulatorProcess(Given(users_function(engine, stated)), about="it", seconds=600.0))
    frames = round(SECONDS / DT)
    q0, v0 = draw_releases(model, ReleaseSettings(), tosses, gravity=9.81, rng=np.random.default_rng(seed))
    near = users.prepared(State(q0, v0), np.full(tosses, frames), DT, most_lost=1.0, **how)
    forms = {"whole": replace(users, by_frame=False), "rigid": users, "nearest": near}
    yield {"contact": asdict(near.contact)}
    for name in names:
        try:
            effects = world_of(SynthesizeSettings(engine=engine, effects=CASES[name]), model)
        except ConfigError as error:
            yield {"case": name, "left_out": str(error)}
            continue
        q, v = users_function(engine, effects)(*effects.to_ground(q0, v0), frames, DT)
        starts = np.arange(0, frames - WINDOW, WINDOW // 2)
        q, v = effects.recorded(q, v)
        first_q, first_v = (x[:, starts].reshape(-1, x.shape[-1]) for x in (q, v))
        true = np.concatenate([np.stack([each[s : s + WINDOW + 1] for s in starts]) for each in q])

        before = _errors(replace(users, recording=effects.recording), first_q, first_v, true)
        line: dict[str, Any] = {"case": name, "effects": CASES[name], "before": float(np.median(before))}
        for form, world in forms.items():
            began = time.process_time()
            after = _errors(world_with(world, CASES[name]), first_q, first_v, true)
            line[form] = float(np.median(after))
            closed = 1 - (np.minimum(after, 30) ** 2).sum() / (np.minimum(before, 30) ** 2).sum()
            line[form + "_closed"] = round(float(closed), 3)
            line[form + "_cpu_s"] = round(time.process_time() - began, 2)
        yield line


def residuals(engine: Engine, names: list[str], *, tosses: int, seed: int) -> Iterator[dict[str, Any]]:
    """One line a case: what the best that a diagnosis could find leaves."""
    for name in names:
        effects, own_seed = CASES[name], seed + 100 * list(CASES).index(name)
        dataset = tossid.synthesize("cube", tosses=tosses, seed=own_seed, engine=engine, effects=effects, noise=NOISE)
        made_by = world_of(SynthesizeSettings(engine=engine, effects=effects), dataset.object)
        if made_by.recording != RecordingErrors() or made_by.ground_height or any(made_by.ground_tilt):
            yield {"case": name, "left_out": "the engine's frame is not the recorded one"}
            continue
        stated, windows = World(dataset.object), make_windows(dataset.tosses, dataset.object)
        first = State(*(np.stack([getattr(toss, x)[0] for toss in dataset.tosses]) for x in ("q", "v")))
        frames = np.array([len(toss) - 1 for toss in dataset.tosses])
        worlds = {}
        for form, world in (("same_engine", made_by), ("with_effect", stated)):
            process = SimulatorProcess(Given(users_function(engine, world)), about="it", seconds=600.0)
            users = UsersWorld.of(stated, process).prepared(
                first, frames, windows.dt, most_lost=1.0, **steps_of(stated)
            )
            worlds[form] = users if form == "same_engine" else world_with(users, effects)
        line: dict[str, Any] = {"case": name}
        for form, world in worlds.items():
            for restarts in range(3):
                kept, whitening, found = linearised(windows, world, refine=4, restarts=restarts)
                squares = np.minimum(whitening(found)[kept.counted] ** 2, 900.0)
                line[f"{form}_{restarts}"] = round(float(np.sqrt(squares.mean())), 3)
        yield line


def _errors(world: World, q: Array, v: Array, true: Array) -> Array:
    """(W,) root mean squares of windows' errors, in standard deviations of noise."""
    run = world.roll_out(q, v, n_steps=WINDOW, dt=DT, **steps_of(world))
    std = np.array([NOISE.position] * 3 + [NOISE.rotation] * 3)
    size: Array = np.sqrt(((difference(true, run) / std) ** 2)[:, 1:].mean((1, 2)))
    return np.nan_to_num(size, nan=np.inf)


def main(arguments: list[str]) -> None:
    """Cases that are not in the file yet, the table of a file, or predictions."""
    keys = dict(each.split("=", 1) for each in arguments if "=" in each)
    names = [each for each in arguments if "=" not in each] or list(CASES)
    engine = ENGINES[keys.get("engine", "mujoco")]
    if "substeps" in keys:
        engine = replace(engine, substeps=int(keys["substeps"]))
    if "table" in keys:
        sys.stdout.write(table(read_lines(keys["table"])) + "\n")
        return
    looks = {"predict": predict, "residuals": residuals}
    for look in (function for key, function in looks.items() if keys.get(key) == "true"):
        for line in look(engine, names, tosses=int(keys.get("tosses", 16)), seed=int(keys.get("seed", 1))):
            sys.stdout.write(json.dumps(line) + "\n")
            sys.stdout.flush()
        return
    out = Path(keys["out"])
    done = [line["case"] for line in lines_so_far(out)]
    for name in (each for each in names if each not in done):
        line = run(
            engine,
            name,
            tosses=int(keys.get("tosses", 16)),
            seed=int(keys.get("seed", 1)),
            repeats=int(keys.get("repeats", 0)),
            without=tuple(filter(None, keys.get("without", "").split(","))),
        )
        add_line(out, line)


if __name__ == "__main__":
    main(sys.argv[1:])
