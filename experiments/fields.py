"""What a learned acceleration recovers of fields of force, also where no training toss flew.

    python -m experiments.fields OUT.jsonl --fields vortex spring --tosses 60

Tosses of the cube are simulated in a world with a field. Models learn from those whose flight stays within stripes of
the ground, by the implicit loss alone. Held-out flights are of two kinds: within the same stripes, and between them.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import tossid
from experiments.harness import Case, Line, markdown, measured, options, succeeded
from pipelines.cli.failures import guarded
from tossid.models import TrainedModel, variant
from tossid.objects import GRAVITY
from tossid.physics.effects import (
    Effect,
    InMujoco,
    NotExpressible,
    Parameter,
    Strength,
    World,
    register_effect,
    unregister_effect,
)
from tossid.physics.effects.strength import signed
from tossid.physics.effects.wrenches import acceleration_of_forces, airborne, learned_field
from tossid.physics.forces import PoweredForce
from tossid.settings.synthesis import NoiseSettings, ReleaseSettings, SynthesizeSettings
from tossid.store import Dataset
from tossid.synthesis.tosses import world_of
from tossid.types import Toss

FIELDS: Mapping[str, Mapping[str, Mapping[str, float]]] = {
    "vortex": {"vortex": {"c_npm": 3.0}},
    "viscous": {"linear_drag": {"c_nspm": 0.3}, "spin_drag": {"c_nms": 3e-4}},
    "uniform": {"uniform_force": {"x_n": 0.8, "y_n": -0.5}},
    "spring": {"position_force": {"k_npm": 3.0, "x_m": 0.1, "y_m": -0.1, "z_m": 0.2}},
    "gravity": {"gravity": {"g_ms2": 8.0}},
    "steady vortex": {"steady_vortex": {"f_n": 1.0}},
}
"""Fields by name: effects and their parameters. The steady vortex is not linear in the place."""


def _steady(world: World, p: Mapping[str, float]) -> World:
    powered = {"powered": float(PoweredForce.VORTEX), "power": -1.0}
    return replace(world, forces=world.forces._replace(vortex=p["f_n"], **powered))


STEADY_VORTEX = Effect(
    name="steady_vortex",
    family="field",
    says="a force of the same size everywhere around the world's vertical axis, as dair_pll injects it",
    parameters=(Parameter("f_n", 0.0, -20.0, 20.0, 0.05),),
    apply=_steady,
    mujoco=InMujoco(),
    mjcf=NotExpressible("MJCF has no force of this form"),
    strength=Strength(0.1, 3.0, signed("f_n")),
)
"""Which the library lacks: it is registered while tosses are made."""
STRIPE_M = 0.2
"""Width of stripes and of what is between them, along x [m]."""
NOISE = NoiseSettings(position=5e-5, rotation=5e-4, velocity=5e-3, spin=5e-2)
"""Of the real cube, as its flights show it, and somewhat more."""
HEADS = ("force [m/s²]", "held out [%]", "between [%]")


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


def throw(field: str, *, tosses: int, held_out: int, seed: int) -> Thrown:
    """Tosses of the cube in a field, in stripes and between them.

    Args:
        field: Its name.
        tosses: To learn from.
        held_out: Of each kind.
        seed: Of the tosses.
    """
    settings = SynthesizeSettings(
        tosses=4 * (tosses + 3 * held_out),
        seconds=0.5,  # a flight and its first impacts
        seed=seed,
        effects={name: dict(values) for name, values in FIELDS[field].items()},
        release=ReleaseSettings(landing=0.6, speed=(0.0, 0.8)),
        noise=NOISE,
    )
    register_effect(STEADY_VORTEX)
    try:
        dataset = tossid.synthesize("cube", settings=settings)
        world = world_of(settings, dataset.object)
    finally:
        unregister_effect(STEADY_VORTEX.name)
    assert dataset.truth is not None
    inside: list[tuple[Toss, Toss]] = []
    between: list[Toss] = []
    for toss, true in zip(dataset.tosses, dataset.truth.tosses, strict=True):
        stripe = np.floor(true.q[airborne(dataset.object, true.q), 0] / STRIPE_M)
        if len(stripe) and (stripe == stripe[0]).all():
            if stripe[0] % 2 == 0:
                inside.append((toss, true))
            else:
                between.append(true)
    splits = ["train"] * tosses + ["validation"] * held_out + ["test"] * held_out
    learned = [replace(toss, split=split) for (toss, _), split in zip(inside, splits, strict=False)]
    return Thrown(
        replace(dataset, tosses=tuple(learned), truth=None),
        tuple(between[:held_out]),
        tuple(true for _, true in inside[len(splits) - held_out : len(splits)]),
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
    q, v = (np.concatenate([getattr(toss, name) for toss in tosses]) for name in ("q", "v"))
    flying = airborne(world.object, q)
    q, v = q[flying], v[flying]
    mechanics = trained.model.mechanics()
    assert mechanics is not None
    given = np.array([0.0, 0.0, -GRAVITY])
    found = learned_field(mechanics.object, mechanics.k_res, q, v)[:, :3] - [0.0, 0.0, mechanics.gravity] - given
    true = acceleration_of_forces(world, q, v)[:, :3] - given
    size = float(np.sqrt(np.square(true).sum(axis=1).mean()))
    return 1.0 - float(np.sqrt(np.square(found - true).sum(axis=1).mean())) / size, size


def learned(case: Case) -> Line:
    """What a model learns of a field without rollout stages.

    Args:
        case: Its `field`, `model`, `seed`, and how many `tosses` and `held_out` there are.
    """
    thrown = throw(case["field"], tosses=case["tosses"], held_out=case["held_out"], seed=case["seed"])
    model = replace(variant(case["model"]), horizons=())
    trained = tossid.train(thrown.learned, model=model, seed=case["seed"])
    held, size = recovered(trained, thrown.world, thrown.inside)
    between, _ = recovered(trained, thrown.world, thrown.between)
    return dict(zip(HEADS, (f"{size:.2f}", f"{100 * held:.1f}", f"{100 * between:.1f}"), strict=True))


def main(arguments: list[str]) -> None:
    """Learn the fields that OUT lacks, and print a row for each and each model and seed."""
    given = options(
        __doc__, arguments, out=Path, fields=tuple(FIELDS), models=("cnrp", "cnrp_world"), seeds=(0,), tosses=60,
        held_out=20, processes=1,
    )  # fmt: skip
    sizes = {"tosses": given.tosses, "held_out": given.held_out}
    cases = [
        {"field": field, "model": model, "seed": seed, **sizes}
        for field, model, seed in itertools.product(given.fields, given.models, given.seeds)
    ]
    lines = succeeded(measured(given.out, cases, learned, processes=given.processes))
    heads = ("field", "model", "seed", *HEADS)
    print(markdown(heads, ([line[head] for head in heads] for line in lines)))


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(sys.argv[1:]), "fields"))
