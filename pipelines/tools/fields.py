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
    from tossid.evaluation.evaluate import Scores
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
STRIPE_M = 0.2
"""Width of stripes and of what is between them, along x [m]."""
NOISE = {"position": 5e-5, "rotation": 5e-4, "velocity": 5e-3, "spin": 5e-2}
"""Of the real cube, as its flights show it, and somewhat more."""
HEAD = ("field", "force [m/s²]", "model", "seed", "held out [%]", "between [%]", "position [%]", "rotation [deg]")


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
    held_out: int = 30
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
    from tossid.physics.effects.fields import airborne
    from tossid.settings.synthesis import NoiseSettings, ReleaseSettings, SynthesizeSettings
    from tossid.synthesis.tosses import world_of

    settings = SynthesizeSettings(
        tosses=6 * (study.tosses + 3 * study.held_out),
        seed=seed,
        effects={name: dict(values) for name, values in FIELDS.get(field, {}).items()},
        release=ReleaseSettings(landing=0.6, speed=(0.0, 0.8)),
        noise=NoiseSettings(**NOISE),
    )
    with known_vortex():
        dataset = tossid.synthesize("cube", settings=settings)
        world = world_of(settings, dataset.object)
    assert dataset.truth is not None
    inside, between = [], []
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
    from tossid.physics.effects.fields import acceleration_of_forces, airborne, learned_field, share_recovered

    q, v = (np.concatenate([getattr(toss, name) for toss in tosses]) for name in ("q", "v"))
    flying = airborne(world.object, q)
    q, v = q[flying], v[flying]
    mechanics = trained.model.mechanics()
    assert mechanics is not None
    given = np.array([0.0, 0.0, -GRAVITY])
    found = learned_field(mechanics.object, mechanics.k_res, q, v)[:, :3] - [0.0, 0.0, mechanics.gravity] - given
    true = acceleration_of_forces(world, q, v)[:, :3] - given
    size = float(np.sqrt(np.square(true).sum(axis=1).mean()))
    return share_recovered(found, true), size


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
    from tossid.models import variant

    console.say("| " + " | ".join(HEAD) + " |")
    console.say("|" + "---|" * len(HEAD))
    costs: dict[str, list[np.ndarray]] = {}
    for field in study.fields:
        for seed in study.seeds:
            thrown = None if field == REAL else throw(field, study, seed)
            data = (
                tossid.ingest(folder / "contactnets_cube", source="contactnets") if thrown is None else thrown.learned
            )
            scores = {}
            for model in MODELS:
                count = study.tosses if thrown is None else None
                settings = variant(model) if field in (NONE, REAL) else replace(variant(model), horizons=())
                trained = tossid.train(data, model=settings, seed=seed, tosses=count)
                scores[model] = tossid.evaluate(trained, data.split("test"))
                shares = ("", "", "")
                if thrown is not None and field != NONE:
                    held, size = recovered(trained, thrown.world, thrown.inside)
                    between, _ = recovered(trained, thrown.world, thrown.between)
                    shares = (f"{size:.2f}", f"{100 * held:.1f}", f"{100 * between:.1f}")
                console.say(row(field, model, seed, shares, scores[model]))
            if field in (NONE, REAL):
                one, other = (scores[model].per_toss for model in MODELS)
                apart = [
                    other.position_error_pct - one.position_error_pct,
                    other.rotation_error_deg - one.rotation_error_deg,
                ]
                costs.setdefault(field, []).append(np.stack(apart))
    for field, found in costs.items():
        parts = []
        for name, values in zip(("position [%]", "rotation [deg]"), np.mean(found, axis=0), strict=True):
            summary = summarize(values)
            low, high = summary["ci95"]
            parts.append(f"{name} {summary['mean']:+.2f} ({low:+.2f} to {high:+.2f})")
        console.say(f"{field}: {MODELS[1]} less {MODELS[0]}, {len(found)} seeds: {', '.join(parts)}")


def row(field: str, model: str, seed: int, shares: tuple[str, str, str], scores: Scores) -> str:
    """A Markdown row."""
    size, held, between = shares
    means = [f"{scores.metrics[name]['mean']:.1f}" for name in ("position_error_pct", "rotation_error_deg")]
    return "| " + " | ".join([field, size, f"`{model}`", f"{seed}", held, between, *means]) + " |"


def parsed(arguments: list[str]) -> tuple[Path, Study]:
    """The command's arguments."""
    parser = ArgumentParser(prog="python -m pipelines.tools.fields", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--fields", nargs="+", default=list(Study.fields), choices=Study.fields)
    parser.add_argument("--tosses", type=int, default=Study.tosses)
    parser.add_argument("--seeds", type=int, default=len(Study.seeds))
    found = parser.parse_args(arguments)
    return found.folder, Study(tuple(found.fields), found.tosses, Study.held_out, tuple(range(found.seeds)))


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(*parsed(sys.argv[1:]), Console()), "fields"))
