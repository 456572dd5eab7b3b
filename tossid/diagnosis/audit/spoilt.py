"""Spoilt simulators on real tosses: a parameter of a simulator that fits the tosses is changed, to be found again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tossid.diagnosis.audit.cases import Case
from tossid.diagnosis.audit.scores import fits_alone
from tossid.diagnosis.audit.strengths import SPOILT, world_with
from tossid.diagnosis.explain import explain
from tossid.diagnosis.problem import Problem
from tossid.physics.effects import World
from tossid.physics.effects.strength import Values
from tossid.settings.diagnosis.audit import AuditSettings
from tossid.settings.diagnosis.likelihood import WindowSettings
from tossid.store import read_dataset
from tossid.types import Toss


@dataclass(frozen=True)
class Reference:
    """What real tosses say of the unspoilt simulator.

    Attributes:
        effects: Values of the effects that a diagnosis of the stated simulator finds.
        alone: For each parameter that may be spoilt, the values to which its effect alone is fitted beside them.
    """

    effects: Mapping[str, Values]
    alone: Mapping[str, Values]


def read_case_tosses(data: Path) -> tuple[tuple[Toss, ...], World]:
    """The tosses of a dataset that are at least half a window long, and the stated simulator of their object.

    Args:
        data: The dataset's file.

    Returns:
        The tosses and the simulator.
    """
    dataset = read_dataset(data)
    least = WindowSettings().length // 2
    return tuple(toss for toss in dataset.tosses if len(toss) > least), World(dataset.object)


def real_tosses(data: Path, settings: AuditSettings) -> tuple[tuple[Toss, ...], World]:
    """As many tosses of a dataset as the settings say, drawn by their seed, and the stated simulator.

    Args:
        data: The dataset's file.
        settings: How many tosses, and the seed.

    Returns:
        The tosses and the simulator.
    """
    tosses, world = read_case_tosses(data)
    chosen = np.random.default_rng([settings.seed, 6]).permutation(len(tosses))[: settings.tosses]
    return tuple(tosses[i] for i in sorted(chosen)), world


def find_reference(data: Path, settings: AuditSettings, n_threads: int) -> Reference:
    """Diagnose the stated simulator on real tosses, and fit each parameter that may be spoilt by itself.

    Args:
        data: The dataset's file.
        settings: How many tosses, and the seed.
        n_threads: Threads of the simulator.

    Returns:
        What was found.
    """
    (tosses, world), seed = real_tosses(data, settings), settings.seed % 1000
    found = explain(Problem(tosses, world, seed=seed, n_threads=n_threads)).hypothesis
    effects = {effect.name: effect.named(values) for effect, values in zip(found.effects, found.values, strict=True)}
    alone = fits_alone(tosses, world_with(world, effects), tuple(SPOILT), seed=seed, n_threads=n_threads)
    return Reference(effects, alone)


def spoil(case: Case, world: World, reference: Reference) -> tuple[World, dict[str, Any]]:
    """The spoilt simulator of a case, and the truth: what restores it.

    Args:
        case: The case.
        world: The stated simulator.
        reference: What the real tosses say of it.

    Returns:
        The simulator, and `case`, `effects` (the values to be found) and `spoilt` (the values that spoil).
    """
    name = case.effects[0]
    unspoilt = world_with(world_with(world, reference.effects), {name: reference.alone[name]})
    spoilt = _spoiling_values(case, unspoilt)
    back = {"g_ms2": unspoilt.gravity, "mu": unspoilt.object.friction}
    found = {
        key: back[key] if key in back else 1 / value if key.endswith("_rel") else -value
        for key, value in spoilt.items()
    }
    truth = {"case": case.as_json(), "effects": {name: found}, "spoilt": spoilt, "displacement": {}}
    return world_with(unspoilt, {name: spoilt}), truth


def _spoiling_values(case: Case, unspoilt: World) -> Values:
    """Values of the effect that spoils the simulator: gravity by a sum, friction by a factor."""
    rng = np.random.default_rng([case.seed, 3])
    strength = SPOILT[case.effects[0]]
    size = float(np.exp(rng.uniform(np.log(strength.low), np.log(strength.high))))
    values = {key: float(x) for key, x in strength.values(size, rng.uniform(-1, 1, 8)).items()}
    now = {"g_ms2": values.get("g_ms2", 0) + unspoilt.gravity, "mu": values.get("mu", 1) * unspoilt.object.friction}
    return {key: now.get(key, x) for key, x in values.items()}
