"""A diagnosis made by hand, for what is done with one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tossid.diagnosis.findings import Brings, Change, Felt, Finding, Gap, Interval
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.localisation.place import Corner, Place
from tossid.diagnosis.localisation.relations import COMPONENTS, STATES, relate
from tossid.diagnosis.result import Diagnosis
from tossid.objects import ObjectModel, load_object
from tossid.physics.effects import LIBRARY, Effect, World

EFFECTS: dict[str, Effect] = {effect.name: effect for effect in LIBRARY}
STATED = World(load_object("cube"))


def hypothesis(model: ObjectModel, **values: list[float]) -> Hypothesis:
    """The nominal world with effects: `friction=[0.3]`."""
    made = Hypothesis(World(model))
    for name, numbers in values.items():
        made = made.plus(EFFECTS[name], np.array(numbers, dtype=float))
    return made


def gap(rms: float, *, n: int, seed: int = 0) -> Gap:
    """A gap in sliding, of n tosses."""
    rng = np.random.default_rng(seed)
    rows = []
    for toss in range(n):
        touch = int(rng.integers(20, 40))
        for k in range(1, int(rng.integers(60, 100))):
            phase = 1 if k < touch else 2 if k < touch + 2 else 3 if k < touch + 25 else 5
            rows.append((toss, k / 148, phase, (rms**2 - 1) * (phase == 3) + 0.1 * rng.normal()))
    phases, channels = (
        {name: Interval(x, x - 0.05, x + 0.05) for name, x in shares.items()}
        for shares in (
            {"flight": 0.0, "impact": 0.2, "slide": 0.7, "roll": 0.05, "rest": 0.05},
            {"p_x": 0.4, "p_y": 0.3, "p_z": 0.1, "r_x": 0.05, "r_y": 0.05, "r_z": 0.1},
        )
    )
    total = Interval(rms, 0.9 * rms, 1.1 * rms)
    return Gap(total, 1.0, 0.2 * rms, 0.1 * rms, phases, channels, np.array(rows), ())


def finding(effect: Effect, verdict: str, **changes: Any) -> Finding:
    """What the tosses say of an effect, as if it had been fitted."""
    phases = tuple(phase.name.lower() for phase in effect.phases)
    evidence = {"gain": 0.0, "p_value": 1.0, "n_tosses": 20.0}
    stated = {p.name: float(x) for p, x in zip(effect.parameters, effect.nominal(STATED), strict=True)}
    plain = Finding(effect.name, verdict, effect.says, phases, {}, stated, evidence, Interval(0, 0, 0))  # type: ignore[arg-type]
    return replace(plain, detectable={p.name: p.step for p in effect.parameters}, **changes)


def diagnosis(model: ObjectModel, *, n: int = 20) -> Diagnosis:
    """Friction is 0.3, or it may be cohesion."""
    found = [
        finding(
            EFFECTS["friction"],
            "confusable",
            parameters={"mu": Interval(0.3, 0.297, 0.303)},
            evidence={"gain": 400.0, "p_value": 1e-8, "n_tosses": 20.0},
            gap_closed=Interval(0.93, 0.85, 0.98),
            confusable_with=("cohesion",),
            felt=Felt(12.1, 5.2),
            frequency=0.97,
        ),
        finding(
            EFFECTS["cohesion"],
            "confusable",
            parameters={"c_n": Interval(0.2, 0.15, 0.25)},
            evidence={"gain": 380.0, "p_value": 1e-7, "n_tosses": 20.0},
            gap_closed=Interval(0.88, 0.8, 0.95),
            confusable_with=("friction",),
        ),
        finding(EFFECTS["gravity"], "not_supported", evidence={"gain": -3.0, "p_value": 0.9, "n_tosses": 20.0}),
        finding(EFFECTS["magnus"], "not_identifiable"),
    ]
    return Diagnosis(
        verdict="explained",
        gap=gap(5.0, n=n),
        left=gap(1.2, n=n, seed=1),
        findings=tuple(found),
        change=(Change("friction", "mu", 0.18, Interval(0.3, 0.297, 0.303)),),
        brings=brings(12.5, 0.3, n=n),
        gap_closed=Interval(0.93, 0.85, 0.98),
        unexplained={},
        hypothesis=hypothesis(model, friction=[0.3]),
        n_tosses=n,
        seconds=12.0,
        folds=4,
        draws=800,
        probability_none=0.0,
        alternatives=(hypothesis(model, cohesion=[0.2]),),
    )


def brings(before: float, after: float, *, n: int) -> Brings:
    """Whole tosses with so many percent of the width, and half as many degrees, before and after."""
    spread = np.linspace(0.8, 1.2, n)[:, None] * np.array([1.0, 0.5])
    return Brings("tossid", before * spread, after * spread, 0.1048)


def without_effects(model: ObjectModel, verdict: str, *, n: int = 20) -> Diagnosis:
    """Nothing is named."""
    made = diagnosis(model, n=n)
    return replace(
        made,
        verdict=verdict,  # type: ignore[arg-type]
        left=made.gap,
        findings=tuple(finding(effect, "not_supported") for effect in LIBRARY),
        change=(),
        brings=brings(12.5, 12.5, n=n),
        gap_closed=Interval(0, 0, 0),
        hypothesis=Hypothesis(World(model)),
        alternatives=(),
    )


def with_place(model: ObjectModel) -> Diagnosis:
    """A diagnosis with a place: drag in flight, nothing in contact, and one corner that is worst."""
    rng = np.random.default_rng(0)
    n = 40
    toss = np.arange(n) % 20
    states = rng.normal(size=(n, len(STATES)))
    value, variance = 0.05 * rng.normal(size=(n, len(COMPONENTS))), np.full((n, len(COMPONENTS)), 1e-3)
    value[:, 3] -= 0.3 * states[:, STATES.index("horizontal_speed")]
    flight = relate("flight", value, variance, states, toss, np.random.default_rng(1))
    contact = relate("contact", rng.normal(size=value.shape), variance, states, toss, np.random.default_rng(1))
    shares = np.array([0.5, *np.full(7, 0.5 / 7)])
    both = [
        tuple(
            Corner((float(x), float(y), float(z)), Interval(k * s, k * s / 2, k * s * 2), 40, 8 * k * s)
            for (x, y, z), s in zip(model.corner_pos, shares, strict=True)
        )
        for k in (1.0, 0.3)
    ]
    return replace(diagnosis(model), place=Place((flight, contact), both[0], (flight,), both[1]))
