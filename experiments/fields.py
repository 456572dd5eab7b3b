"""`make fields`: what a learned acceleration recovers of fields of force, and what it costs where there is none.

Tosses of the cube are simulated in a world with a field. Models learn from those whose flight stays within stripes of
the ground. Held-out flights are of two kinds: within the same stripes, and between them. These models learn k_res and
contact by the implicit loss alone. Where there is no field, whole trainings are compared by their rollouts of the same
held-out tosses, and of the real cube's.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from pipelines.cli.console import Console
from pipelines.cli.failures import guarded

if TYPE_CHECKING:
    from tossid.evaluation.metrics import TossScores
    from tossid.models import TrainedModel
    from tossid.physics.effects import Effect, World
    from tossid.store import Dataset
    from tossid.types import Toss

NONE, REAL = "none", "real cube"
FIELDS: Mapping[str, Mapping[str, Mapping[str, float]]] = {
    "vortex": {"vortex": {"c_npm": 3.0}},
    "viscous": {"linear_drag": {"c_nspm": 0.3}, "spin_drag": {"c_nms": 3e-4}},
    "uniform": {"uniform_force": {"x_n": 0.8, "y_n": -0.5}},
    "spring": {"position_force": {"k_npm": 3.0, "x_m": 0.1, "y_m": -0.1, "z_m": 0.2}},
    "gravity": {"gravity": {"g_ms2": 8.0}},
    "steady vortex": {"steady_vortex": {"f_n": 1.0}},
}
"""Fields by name: effects and their parameters. The steady vortex is not linear in the place."""
MODELS = ("cnrp", "cnrp_world")
ERRORS = ("position_error_pct", "rotation_error_deg")
STRIPE_M = 0.2
"""Width of stripes and of what is between them, along x [m]."""
NOISE = {"position": 5e-5, "rotation": 5e-4, "velocity": 5e-3, "spin": 5e-2}
"""Of the real cube, as its flights show it, and somewhat more."""
HEAD = (
    "field",
    "model",
    "seed",
    "force [m/s²]",
    "held out [%]",
    "between [%]",
    "stands for",
    "position [%]",
    "rotation [deg]",
)


@dataclass(frozen=True)
class Study:
    """What is learned.

    Attributes:
        fields: Their names; `NONE` and `REAL` for no field.
        tosses: To learn from.
        held_out: Of each kind.
        seeds: Of tosses and trainings.
    """

    fields: tuple[str, ...] = (*FIELDS, NONE, REAL)
    tosses: int = 100
    held_out: int = 20
    seeds: tuple[int, ...] = (0, 1, 2)


@dataclass(frozen=True)
class Thrown:
    """Tosses in one world.

    Attributes:
        learned: With splits; those of "test" are held out within the stripes.
        between: Exact tosses between the stripes.
        inside: Exact tosses within the stripes, which are not learned from.
        world: What acts.
    """

    learned: Dataset
    between: tuple[Toss, ...]
    inside: tuple[Toss, ...]
    world: World


def steady_vortex() -> Effect:
    """A force of the same size everywhere around the world's vertical axis, as dair_pll injects it."""
    from tossid.physics.effects import Effect, InMujoco, NotExpressible, Parameter
    from tossid.physics.effects.strength import Strength, signed
    from tossid.physics.forces import PoweredForce

    def apply(world: World, p: Mapping[str, float]) -> World:
        powered = {"powered": float(PoweredForce.VORTEX), "power": -1.0}
        return replace(world, forces=world.forces._replace(vortex=p["f_n"], **powered))

    return Effect(
        name="steady_vortex",
        family="field",
        says="a force of the same size everywhere around the world's vertical axis",
        parameters=(Parameter("f_n", 0.0, -20.0, 20.0, 0.05),),
        apply=apply,
        mujoco=InMujoco(),
        mjcf=NotExpressible("MJCF has no force of this form"),
        strength=Strength(0.1, 3.0, signed("f_n")),
    )


@contextmanager
def known_vortex() -> Iterator[None]:
    """While the steady vortex is an effect of the library."""
    from tossid.physics.effects import register_effect, unregister_effect

    register_effect(steady_vortex())
    try:
        yield
    finally:
        unregister_effect("steady_vortex")


def throw(field: str, study: Study, seed: int) -> Thrown:
    """Tosses of the cube in a field, in stripes and between them.

    Args:
        field: Its name; `NONE` for none.
        study: How many.
        seed: Of the tosses.
    """
    import numpy as np

    import tossid
    from tossid.physics.effects.wrenches import airborne
    from tossid.settings.synthesis import NoiseSettings, ReleaseSettings, SynthesizeSettings
    from tossid.synthesis.tosses import world_of

    settings = SynthesizeSettings(
        tosses=4 * (study.tosses + 3 * study.held_out),
        seconds=0.5,  # a flight and its first impacts
        seed=seed,
        effects={name: dict(values) for name, values in FIELDS.get(field, {}).items()},
        release=ReleaseSettings(landing=0.6, speed=(0.0, 0.8)),
        noise=NoiseSettings(**NOISE),
    )
    with known_vortex():
        dataset = tossid.synthesize("cube", settings=settings)
        world = world_of(settings, dataset.object)
    assert dataset.truth is not None
    inside: list[tuple[Toss, Toss]] = []
    between: list[tuple[Toss, Toss]] = []
    for toss, true in zip(dataset.tosses, dataset.truth.tosses, strict=True):
        stripe = np.floor(true.q[airborne(dataset.object, true.q), 0] / STRIPE_M)
        if len(stripe) and (stripe == stripe[0]).all():
            (inside if stripe[0] % 2 == 0 else between).append((toss, true))
    splits = ["train"] * study.tosses + ["validation"] * study.held_out + ["test"] * study.held_out
    learned = [replace(toss, split=split) for (toss, _), split in zip(inside, splits, strict=False)]
    first = len(splits) - study.held_out
    return Thrown(
        replace(dataset, tosses=tuple(learned), truth=None),
        tuple(true for _, true in between[: study.held_out]),
        tuple(true for _, true in inside[first : len(splits)]),
        world,
    )


def recovered(trained: TrainedModel, world: World, tosses: tuple[Toss, ...]) -> tuple[float, float]:
    """The share of a field that a model has learned, and the field's size [m/s²], in the flights of tosses.

    The field is what acts beside the stated gravity, the model's is what it has beside that.

    Args:
        trained: The model.
        world: What truly acts.
        tosses: Exact ones.
    """
    import numpy as np

    from tossid.objects import GRAVITY
    from tossid.physics.effects.wrenches import acceleration_of_forces, airborne, learned_field

    q, v = (np.concatenate([getattr(toss, name) for toss in tosses]) for name in ("q", "v"))
    flying = airborne(world.object, q)
    q, v = q[flying], v[flying]
    mechanics = trained.model.mechanics()
    assert mechanics is not None
    given = np.array([0.0, 0.0, -GRAVITY])
    found = learned_field(mechanics.object, mechanics.k_res, q, v)[:, :3] - [0.0, 0.0, mechanics.gravity] - given
    true = acceleration_of_forces(world, q, v)[:, :3] - given
    size = float(np.sqrt(np.square(true).sum(axis=1).mean()))
    miss = float(np.sqrt(np.square(found - true).sum(axis=1).mean()))
    return 1.0 - miss / size, size


def stands_for(trained: TrainedModel, data: Dataset) -> str:
    """What a diagnosis of held-out tosses says of a model's learned acceleration."""
    from tossid.diagnosis.learned import learned_forces
    from tossid.diagnosis.simulators import world_of_model
    from tossid.physics.effects import effects_for

    found = learned_forces(world_of_model(trained.model), data.of_split("test"), effects_for(data.object))
    if found is None:
        return ""
    named = [
        f"{e.name} ({', '.join(f'{key} {value:.2g}' for key, value in e.parameters.items())}; {100 * e.share:.0f} %)"
        for e in found.stands_for
    ]
    return ", ".join(named) or ("next to nothing" if found.small else "no name")


def main(folder: Path, study: Study, console: Console) -> None:
    """Print a Markdown row for each field, model and seed as it is done, then what no field costs.

    Args:
        folder: Holds contactnets_cube; used for the real cube alone.
        study: What is learned.
        console: Where the rows go.
    """
    import numpy as np

    import tossid
    from tossid.evaluation.metrics import summarize

    console.say("| " + " | ".join(HEAD) + " |")
    console.say("|" + "---|" * len(HEAD))
    for field in study.fields:
        costs = []
        for seed in study.seeds:
            if field == REAL:
                data = tossid.ingest(folder / "contactnets_cube", source="contactnets")
                scores = [without_field(field, model, seed, data, console, tosses=study.tosses) for model in MODELS]
            elif field == NONE:
                data = throw(field, study, seed).learned
                scores = [without_field(field, model, seed, data, console) for model in MODELS]
            else:
                thrown = throw(field, study, seed)
                for model in MODELS:
                    with_field(field, model, seed, thrown, console)
                continue
            costs.append(np.stack([getattr(scores[1], name) - getattr(scores[0], name) for name in ERRORS]))
        if costs:  # seeds of the real cube have the same held-out tosses
            apart = np.mean(costs, axis=0) if field == REAL else np.concatenate(costs, axis=1)
            parts = []
            for name, values in zip(ERRORS, apart, strict=True):
                summary = summarize(values)
                low, high = summary["ci95"]
                parts.append(f"{name} {summary['mean']:+.2f} ({low:+.2f} to {high:+.2f})")
            console.say(f"{field}: {MODELS[1]} less {MODELS[0]}, {len(costs)} seeds: {', '.join(parts)}")


def with_field(field: str, model: str, seed: int, thrown: Thrown, console: Console) -> None:
    """Learn a field without rollout stages, and print what was recovered of it."""
    import tossid
    from tossid.models import variant

    trained = tossid.train(thrown.learned, model=replace(variant(model), horizons=()), seed=seed)
    held, size = recovered(trained, thrown.world, thrown.inside)
    between, _ = recovered(trained, thrown.world, thrown.between)
    shares = [f"{size:.2f}", f"{100 * held:.1f}", f"{100 * between:.1f}"]
    _say(console, [field, f"`{model}`", f"{seed}", *shares, stands_for(trained, thrown.learned), "", ""])


def without_field(
    field: str, model: str, seed: int, data: Dataset, console: Console, *, tosses: int | None = None
) -> TossScores:
    """Train a model where there is no field, print its rollout errors, and return them toss by toss."""
    import tossid

    trained = tossid.train(data, model=model, seed=seed, tosses=tosses)
    scores = tossid.evaluate(trained, data.split("test"))
    means = [f"{scores.metrics[name]['mean']:.1f}" for name in ERRORS]
    _say(console, [field, f"`{model}`", f"{seed}", "", "", "", stands_for(trained, data), *means])
    return scores.per_toss


def _say(console: Console, cells: list[str]) -> None:
    console.say("| " + " | ".join(cells) + " |")


def parsed(arguments: list[str]) -> tuple[Path, Study]:
    """The command's arguments."""
    parser = ArgumentParser(prog="python -m experiments.fields", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--fields", nargs="+", default=list(Study.fields), choices=Study.fields)
    parser.add_argument("--tosses", type=int, default=Study.tosses)
    parser.add_argument("--seeds", type=int, default=len(Study.seeds))
    found = parser.parse_args(arguments)
    return found.folder, Study(tuple(found.fields), found.tosses, Study.held_out, tuple(range(found.seeds)))


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(*parsed(sys.argv[1:]), Console()), "fields"))
