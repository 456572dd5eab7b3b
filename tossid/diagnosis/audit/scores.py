"""Scores of diagnoses against the truth of their cases."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, get_args

import numpy as np

from tossid.diagnosis.audit.cases import PAIRS, SEVERAL
from tossid.diagnosis.audit.over_order import DRIFT, NULLS, STEP
from tossid.diagnosis.audit.ranks import joint_rank, rank, share_of, summarise_ranks
from tossid.diagnosis.audit.strengths import world_with
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.localisation.gap import share_left
from tossid.diagnosis.localisation.noise import noise_floor
from tossid.diagnosis.selection.contact_law import with_contact_law
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.screening import screen
from tossid.physics.effects import World, effect_named
from tossid.physics.effects.strength import Values
from tossid.settings.diagnosis.audit import CaseKind, ScoreSettings
from tossid.types import Phase, Toss

_LEAST_PROBABILITY = 0.02
"""Distance from 0 and 1 at which probabilities enter the logarithmic score."""


def closable_share(tosses: Sequence[Toss], world: World, effects: Mapping[str, Values], *, seed: int) -> float:
    """The share of the gap that the true effects close; no diagnosis can be asked to close more.

    Args:
        tosses: The case's tosses.
        world: The stated world.
        effects: The true effects and their values.
        seed: Seed of the folds.

    Returns:
        The share of the gap above the noise floor.
    """
    validator = CrossValidator.of(tosses, world.object, seed=seed)
    validator, best = with_contact_law(validator, world_with(world, effects))
    law = world.law._replace(lifting=best.law.lifting, impulse_parts=best.law.impulse_parts)
    world = replace(world, law=law)
    first, last = validator.evaluate(Hypothesis(world)), validator.evaluate(Hypothesis(world_with(world, effects)))
    floor = noise_floor(validator.windows)
    return share_left(first, last, validator, floor)[0].value


def fits_alone(
    tosses: Sequence[Toss], world: World, names: Sequence[str], *, seed: int, n_threads: int = 1
) -> dict[str, Values]:
    """The values to which each effect alone is fitted; a spoilt parameter is compared with them.

    Args:
        tosses: The tosses.
        world: The world to which each effect is added.
        names: Names of the effects.
        seed: Seed of the folds.
        n_threads: Threads of the simulator.

    Returns:
        Values by effect and parameter.
    """
    validator = CrossValidator.of(tosses, world.object, seed=seed, n_threads=n_threads)
    validator, world = with_contact_law(validator, world)
    first = validator.evaluate(Hypothesis(world))

    def fitted(name: str) -> Values:
        effect = effect_named(name)
        begin = screen(validator, first, effect)
        return effect.named(validator.refit(begin.evidence(first), begin.start).hypothesis.values_of(name))

    return dict(zip(names, validator.map(fitted, names), strict=True))


def score(
    truth: Mapping[str, Any],
    gap: Mapping[str, Any],
    *,
    closable: float | None = None,
    settings: ScoreSettings = ScoreSettings(),
) -> dict[str, Any]:
    """What is right and wrong in a diagnosis.

    Args:
        truth: `case` (`Case.as_json`) and `effects` (values by effect and parameter; for a spoilt simulator the values
            that restore it).
        gap: The content of gap.json.
        closable: Share of the gap that the true effects close, where it is known.
        settings: What counts as right.

    Returns:
        `right`: by the measure of the case's kind; what is named as too small to matter counts after what matters.
        `true`, `named` and `minor` (too small to matter): in order. `false`: names that matter, and neither are true
        nor share a class with a true one. `missed`: true ones that were not found. `parameters`: true values and
        estimates, with the `rank` of the true one and whether the effect `led` its class. `joint_ranks`: of true
        effects (`ranks`). `claims`: probabilities that were stated, and whether what they speak of is true (`claims`).
        `closed`: closed share of the closable gap. `phase_right`: whether the effect acts in the phase in which the gap
        is largest (without its effect in the library: in a phase in which something remains). What does not apply is
        None.
    """
    kind, true = truth["case"]["kind"], dict(truth["effects"])
    found = {finding["name"]: finding for finding in gap["effects"]}
    named, verdict = list(gap["explanation"]["effects"]), gap["explanation"]["verdict"]
    minor = [name for name in gap["explanation"].get("minor", ()) if found[name]["verdict"] != "candidate"]
    classes = {name: [name, *found[name]["confusable_with"]] for name in (*named, *minor)}
    inside = {t: any(t in group[: settings.largest_class] for group in classes.values()) for t in true}
    out: dict[str, Any] = {
        "kind": kind,
        "verdict": verdict,
        "true": list(true),
        "named": named,
        "minor": minor,
        "classes": classes,
        "false": [name for name in named if not set(classes[name]) & set(true)],
        "missed": [],
        "parameters": [],
        "joint_ranks": [],
        "closed": None,
        "phase_right": None,
        "claims": claims(gap, kind, set(true)),
    }
    where = [share["phase"] for share in gap["explanation"]["unexplained_where"]]
    if kind == "order":
        # (`score_over_order` has the rest)
        return {**out, "right": None}
    if kind in ("null", "outside"):
        # what is no effect of the library must get no name
        return {**out, "right": not named, "hedged": kind == "null" or verdict != "explained", "false": named}
    phases = {Phase(p).name.lower() for name in true for p in effect_named(name).phases}
    if kind == "without":
        phase_right = bool(set(where) & phases) if where else None  # an effect may be too weak to leave a gap
        return {**out, "right": verdict != "explained", "phase_right": phase_right, "false": named}
    first = next(iter(classes.values()), [])
    right = bool(true) and (any(t in first for t in true) and len(first) <= settings.largest_class)
    if kind in (*PAIRS, "spoilt"):
        # beside a spoilt parameter, what no simulator has of real tosses may be found too
        right = all(inside.values())
    if kind in SEVERAL:
        right = sum(inside.values()) >= settings.several * len(true) and not out["false"]
    shares = [share for share in gap["gap"]["by_phase"] if share["share"] is not None]
    largest = max(shares, key=lambda share: share["share"])["phase"] if shares else None
    estimated = {name: found[name] for name in true if inside[name] and name in found}
    restored = settings.restored if kind == "spoilt" else None
    fitted = sum(len(found[name]["parameters"]) for name in named)
    parameters, joint = [], []
    for name, finding in estimated.items():
        freedom = max(1.0, finding["evidence"]["n_tosses"] - fitted)
        of_effect = [
            _parameter(name, key, value, finding["parameters"][key], freedom, led=name in classes, restored=restored)
            for key, value in true[name].items()
            if key in finding["parameters"]
        ]
        parameters += of_effect
        ranks = [p["rank"] for p in of_effect]
        if ranks and None not in ranks and len(ranks) == len(finding["correlation"]):
            joint.append(joint_rank(ranks, finding["correlation"], np.random.default_rng(truth["case"]["seed"])))
    closed = gap["explanation"]["gap_closed"]["value"]
    if closable is not None and closed is not None:
        closed = closed / closable if closable > settings.closable else None
    return {
        **out,
        "right": right,
        "missed": [name for name, there in inside.items() if not there],
        "parameters": parameters,
        "joint_ranks": joint,
        "closed": closed,
        "phase_right": largest in phases,
    }


def claims(gap: Mapping[str, Any], kind: str, true: Collection[str]) -> list[dict[str, Any]]:
    """The probabilities that a diagnosis states: of each effect or class that it found, and of "none of the library".

    Args:
        gap: The content of gap.json.
        kind: Of the case.
        true: Names of the effects that are there.

    Returns:
        For each, `of` (a name or "none"), the `probability` and whether it is `true`; none without repeated searches,
        and none of "none" for a spoilt simulator, as nobody knows what else real tosses hold.
    """
    explanation, found = gap["explanation"], {finding["name"]: finding for finding in gap["effects"]}
    none = explanation.get("probability_none")
    if none is None:
        return []
    out = []
    for name in (*explanation["effects"], *explanation.get("candidates", ())):
        group = {name, *found[name]["confusable_with"]}
        probability = min(1.0, sum(found[each]["frequency"] or 0.0 for each in group))
        out.append({"of": name, "probability": probability, "true": not group.isdisjoint(true)})
    if kind != "spoilt":
        out.append({"of": "none", "probability": none, "true": kind in ("null", "outside", "without")})
    return out


def calibration(stated: Sequence[Mapping[str, Any]], bins: int = 5) -> dict[str, Any]:
    """How far stated probabilities are right.

    Args:
        stated: `claims` of all cases.
        bins: Equal parts of the range from 0 to 1.

    Returns:
        `of` how many; `brier`, the mean square of probability minus outcome; `log`, the mean of -log of the
        probability of what was so, with probabilities kept 0.02 away from 0 and 1, which few repeats cannot tell; and
        `reliability`, for each part of the range that has any, the mean `probability`, the share `true` and `of` how
        many. Brier, Monthly Weather Review 78 (1950); Gneiting and Raftery, JASA 102 (2007).
    """
    p, y = (np.array([float(each[key]) for each in stated]) for key in ("probability", "true"))
    if not len(p):
        return {"of": 0, "brier": None, "log": None, "reliability": []}
    near = np.clip(p, _LEAST_PROBABILITY, 1 - _LEAST_PROBABILITY)
    place = np.minimum((p * bins).astype(int), bins - 1)
    parts = [place == k for k in range(bins) if (place == k).any()]
    return {
        "of": len(p),
        "brier": float(np.mean((p - y) ** 2)),
        "log": float(-np.mean(np.log(np.where(y == 1, near, 1 - near)))),
        "reliability": [
            {"probability": float(p[each].mean()), "true": float(y[each].mean()), "of": int(each.sum())}
            for each in parts
        ],
    }


def _parameter(
    name: str, key: str, true: float, found: Mapping[str, Any], freedom: float, *, led: bool, restored: float | None
) -> dict[str, Any]:
    """A true value beside its estimate.

    Args:
        name: Of the effect.
        key: Of the parameter.
        true: Its true value.
        found: Its `value` and `ci95`.
        freedom: Degrees of freedom of the interval.
        led: Whether the effect leads its class.
        restored: Relative error up to which a spoilt parameter is restored.
    """
    value, (low, high) = found["value"], found["ci95"]
    covered = all(x is not None for x in (value, low, high)) and low <= true <= high
    entry = {"effect": name, "name": key, "true": true, "value": value, "ci95": [low, high], "covered": covered}
    entry |= {"led": led, "rank": rank(true, found, freedom)}
    if restored is not None:
        entry["restored"] = value is not None and abs(value - true) <= restored * abs(true)
    return entry


def summarise(
    scores: Sequence[Mapping[str, Any]], *, settings: ScoreSettings = ScoreSettings()
) -> dict[str, dict[str, Any]]:
    """The measures of an audit over scored cases.

    Args:
        scores: What `score` returned for each case.
        settings: What is wanted.

    Returns:
        By measure, the `count` `of` how many, its `share` or `value`, and the share that is `wanted`, if any.
    """
    of = {kind: [s for s in scores if s["kind"] == kind] for kind in (*get_args(CaseKind), "spoilt", "order")}
    covered = [p["covered"] for s in scores for p in s["parameters"]]
    closed = [s["closed"] for s in scores if s["closed"] is not None]
    phase = [s["phase_right"] for s in scores if s["phase_right"] is not None]
    out = {
        "right_name": share_of([s["right"] for s in of["effect"]], settings.right_name),
        "false_names_on_nulls": {"count": sum(not s["right"] for s in of["null"]), "of": len(of["null"])},
        "further_false_names": share_of([bool(s["false"]) for s in of["effect"]], None),
        "coverage": share_of(covered, settings.coverage),
        "closed_median": {
            "value": float(np.median(closed)) if closed else None,
            "of": len(closed),
            "wanted": settings.closed,
        },
        "pairs_both_named": share_of([s["right"] for kind in PAIRS for s in of[kind]], settings.pairs),
        **_several(of),
        "outside_not_named": share_of([s["right"] for s in of["outside"]], settings.outside),
        "outside_not_explained": share_of([s["hedged"] for s in of["outside"]], None),
        "without_not_explained": share_of([s["right"] for s in of["without"]], None),
        "phases_right": share_of(phase, None),
    }
    out |= summarise_ranks(scores)
    stated = [claim for s in scores for claim in s.get("claims", ())]
    for measure, some in (("names", False), ("none", True)):
        of_kind = calibration([claim for claim in stated if (claim["of"] == "none") == some])
        out[f"brier_{measure}"] = {"value": of_kind["brier"], "of": of_kind["of"]}
        out[f"log_score_{measure}"] = {"value": of_kind["log"], "of": of_kind["of"]}
    if of["order"]:
        out |= _over_order(of["order"], settings)
    if of["spoilt"]:
        out["spoilt_named"] = share_of([s["right"] for s in of["spoilt"]], 1.0)
        out["spoilt_restored"] = share_of([p["restored"] for s in of["spoilt"] for p in s["parameters"]], 1.0)
    return out


def _several(of: Mapping[str, Sequence[Mapping[str, Any]]]) -> dict[str, dict[str, Any]]:
    """The measures of cases with several effects at once, where there are any."""
    out = {}
    for kind in (kind for kind in SEVERAL if of[kind]):
        found = [name not in s["missed"] for s in of[kind] for name in s["true"]]
        out[f"{kind}_found"] = share_of(found, None)
        out[f"{kind}_right"] = share_of([s["right"] for s in of[kind]], None)
    return out


def _over_order(scores: Sequence[Mapping[str, Any]], settings: ScoreSettings) -> dict[str, dict[str, Any]]:
    """The measures of cases in which an effect changes over the order."""
    steps, drifts, none = ([s for s in scores if s["form"] in forms] for forms in ((STEP,), (DRIFT,), NULLS))
    off = [abs(s["rate"]["value"] / s["rate"]["true"] - 1) for s in drifts if s["rate"] is not None]
    return {
        "changes_found": share_of([s["moment_right"] for s in steps], settings.moments),
        "changes_named": share_of([s["right"] for s in steps], None),
        "drifts_named": share_of([s["right"] and s["form_right"] for s in drifts], None),
        "drift_rate_off": {"value": float(np.median(off)) if off else None, "of": len(off)},
        "false_changes": {"count": sum(not s["right"] for s in none), "of": len(none)},
    }
