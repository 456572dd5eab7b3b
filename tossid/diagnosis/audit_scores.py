"""How what a diagnosis says of a case is scored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tossid.diagnosis.audit import KINDS, Values, effect_named, world_with
from tossid.diagnosis.evidence import Hypothesis
from tossid.diagnosis.gap import noise_floor, share_left
from tossid.diagnosis.judging import Judge
from tossid.diagnosis.screening import screened
from tossid.physics.effects import World
from tossid.types import Phase, Toss

LARGEST_CLASS = 3
RESTORED = 0.05
"""Share by which a spoilt parameter may be off."""
CLOSABLE = 0.3
"""Least share of the gap that the true effects must close for the share that was closed to mean anything."""


def closable_share(
    tosses: Sequence[Toss], world: World, effects: Mapping[str, Values], *, seed: int, n_threads: int = 1
) -> float:
    """Share of the gap that the true effects close: what is left then is not the diagnosis's to close."""
    judge = Judge.of(tosses, world.object, seed=seed, n_threads=n_threads)
    judge, best = judge.with_contact(world_with(world, effects))
    world = replace(world, law=world.law._replace(lifting=best.law.lifting))
    first, last = judge.start(Hypothesis(world)), judge.start(Hypothesis(world_with(world, effects)))
    floor = noise_floor(last, judge, seed=seed)
    return share_left(first, last, judge, floor)[0].value


def fits_alone(
    tosses: Sequence[Toss], world: World, names: Sequence[str], *, seed: int, n_threads: int = 1
) -> dict[str, Values]:
    """Values of each effect added to a world by itself and fitted: against these a spoilt parameter is held."""
    judge = Judge.of(tosses, world.object, seed=seed, n_threads=n_threads)
    judge, world = judge.with_contact(world)
    first = judge.start(Hypothesis(world))

    def fitted(name: str) -> Values:
        effect = effect_named(name)
        begin = screened(judge, first, effect)
        return effect.named(judge.polished(begin.evidence(first), begin.start).hypothesis.values_of(name))

    return dict(zip(names, judge.each(fitted, names), strict=True))


def score(truth: Mapping[str, Any], gap: Mapping[str, Any], *, closable: float | None = None) -> dict[str, Any]:
    """What is right and wrong in a diagnosis.

    Args:
        truth: `case` (`Case.as_json`), `effects` ({name: values}; for a spoilt simulator the values to be found).
        gap: gap.json. closable: share of the gap that the true effects close.

    Returns:
        right: by the measure of the case's kind (None for what is not judged). named: in order. false: names that
        neither are true nor share a class with a true one. missed: true ones that are not found. parameters: true
        values with what was found. closed: share of the closable gap. phase_right: where the gap is largest (for
        what must stay unexplained: where something is left), the effect acts.
    """
    kind, true = truth["case"]["kind"], dict(truth["effects"])
    found = {finding["name"]: finding for finding in gap["effects"]}
    named, verdict = list(gap["explanation"]["effects"]), gap["explanation"]["verdict"]
    classes = {name: [name, *found[name]["confusable_with"]] for name in named}
    inside = {t: any(t in group[:LARGEST_CLASS] for group in classes.values()) for t in true}
    out: dict[str, Any] = {
        "kind": kind,
        "verdict": verdict,
        "named": named,
        "classes": classes,
        "false": [name for name, group in classes.items() if not set(group) & set(true)],
        "missed": [],
        "parameters": [],
        "closed": None,
        "phase_right": None,
    }
    where = [share["phase"] for share in gap["explanation"]["unexplained_where"]]
    if kind in ("null", "outside"):
        # what is no effect of the library must get no name
        return {**out, "right": not named, "hedged": kind == "null" or verdict != "explained", "false": named}
    phases = {Phase(p).name.lower() for name in true for p in effect_named(name).phases}
    if kind == "without":
        left = verdict in ("unexplained", "partly_explained")
        return {**out, "right": left, "phase_right": bool(set(where) & phases), "false": named}
    first = classes[named[0]] if named else []
    right = bool(true) and (any(t in first for t in true) and len(first) <= LARGEST_CLASS)
    if kind in ("pair", "spoilt"):
        # beside a spoilt parameter, what no simulator has of real tosses may be found too
        right = all(inside.values())
    shares = [share for share in gap["gap"]["by_phase"] if share["share"] is not None]
    largest = max(shares, key=lambda share: share["share"])["phase"] if shares else None
    parameters = [
        _parameter(name, key, value, found.get(name, {}).get("parameters", {}).get(key), spoilt=kind == "spoilt")
        for name, values in true.items()
        for key, value in values.items()
        if inside[name]
    ]
    closed = gap["explanation"]["gap_closed"]["value"]
    if closable is not None and closed is not None:
        closed = closed / closable if closable > CLOSABLE else None
    return {
        **out,
        "right": right,
        "missed": [name for name, there in inside.items() if not there],
        "parameters": [p for p in parameters if p is not None],
        "closed": closed,
        "phase_right": largest in phases,
    }


def _parameter(name: str, key: str, true: float, found: Mapping[str, Any] | None, *, spoilt: bool) -> Any:
    if found is None:
        return None
    value, (low, high) = found["value"], found["ci95"]
    covered = all(x is not None for x in (value, low, high)) and low <= true <= high
    entry = {"effect": name, "name": key, "true": true, "value": value, "ci95": [low, high], "covered": covered}
    if spoilt:
        entry["restored"] = value is not None and abs(value - true) <= RESTORED * abs(true)
    return entry


def summarise(scores: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The audit's measures over scored cases: how many of how many, and what is wanted."""
    of = {kind: [s for s in scores if s["kind"] == kind] for kind in (*dict.fromkeys(KINDS), "spoilt")}
    covered = [p["covered"] for s in scores for p in s["parameters"]]
    closed = [s["closed"] for s in scores if s["closed"] is not None]
    phase = [s["phase_right"] for s in scores if s["phase_right"] is not None]
    out = {
        "right_name": _count([s["right"] for s in of["effect"]], 0.9),
        "false_names_on_nulls": {"count": sum(not s["right"] for s in of["null"]), "of": len(of["null"])},
        "further_false_names": _count([bool(s["false"]) for s in of["effect"]], None),
        "coverage": _count(covered, 0.85),
        "closed_median": {"value": float(np.median(closed)) if closed else None, "of": len(closed), "wanted": 0.9},
        "pairs_both_named": _count([s["right"] for s in of["pair"]], 0.7),
        "outside_not_named": _count([s["right"] for s in of["outside"]], 0.75),
        "outside_not_explained": _count([s["hedged"] for s in of["outside"]], None),
        "without_unexplained": _count([s["right"] for s in of["without"]], None),
        "phases_right": _count(phase, None),
    }
    if of["spoilt"]:
        out["spoilt_named"] = _count([s["right"] for s in of["spoilt"]], 1.0)
        out["spoilt_restored"] = _count([p["restored"] for s in of["spoilt"] for p in s["parameters"]], 1.0)
    return out


def _count(values: Sequence[bool], wanted: float | None) -> dict[str, Any]:
    n = len(values)
    return {"count": int(sum(values)), "of": n, "share": sum(values) / n if n else None, "wanted": wanted}
