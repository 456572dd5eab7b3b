"""Scores of diagnoses against the truth of their cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, get_args

import numpy as np

from tossid.audit.cases import OF_LIBRARY, PAIRS, SEVERAL
from tossid.audit.ranks import rank, uniform_p, within
from tossid.diagnosis.findings import FELT_PCT
from tossid.physics.effects import effect_named
from tossid.settings.audit import CaseKind
from tossid.types import Phase

LARGEST_CLASS = 3
"""Effects among which the true one may be: a name, and those that cannot be told from it."""
SEVERAL_NAMED = 0.75
"""Share of four or eight effects at once that must be named."""

MEASURES: dict[str, tuple[str, str]] = {
    "right_name": ("the right effect is named first, or in its class", "at least 95 %"),
    "right_or_candidate": ("the right effect is named, or is a candidate", ""),
    "false_names_on_nulls": ("an effect is named where there is none", "at most 3 %"),
    "candidates_on_nulls": ("an effect is named or is a candidate where there is none", ""),
    "further_false_names": ("a further effect is named that is not there", "at most 5 %"),
    "coverage": ("95 % intervals that hold the true value", "at least 90 %"),
    "coverage_90": ("intervals of 90 % that hold the true value", ""),
    "coverage_50": ("intervals of 50 % that hold the true value", ""),
    "ranks_uniform": ("probability of ranks of true values as uneven as these", ""),
    "gap_closed": ("share of the gap that is closed (median)", ""),
    "error_closed": ("share of whole tosses' position errors that the changes close (median)", "at least 90 %"),
    "pairs_both_named": ("both effects of a pair are named", "at least 70 %"),
    "four_right": ("of four effects at once, three are named, and none that is not there", ""),
    "eight_right": ("of eight effects at once, six are named, and none that is not there", ""),
    "outside_not_named": ("no effect is named for a force outside the library", "at least 90 %"),
    "outside_not_explained": ("such a gap is not called explained", ""),
    "without_not_named": ("without its effect in the library, none is named", ""),
    "without_not_explained": ("such a gap is not called explained", ""),
    "phases_right": ("the effect acts in the phase with the largest gap", ""),
}
"""The measures of an audit in words, and what is wanted."""


def score(truth: Mapping[str, Any], gap: Mapping[str, Any]) -> dict[str, Any]:
    """What is right and wrong in a diagnosis.

    Args:
        truth: `case` (`Case.as_json`) and `effects` (values by effect and parameter).
        gap: The content of gap.json.

    Returns:
        `right`: by the measure of the case's kind. `classes`: by name, the name and what is confusable with it, in the
        order in which they matter; what whole tosses do not feel (`minor`) comes last, and counts if it is sure.
        `candidates`: the same of what is not sure. `false`: names that matter, and neither are true nor share a class
        with a true one. `missed`: true effects that no class holds. `right_or_candidate`: all true effects are in a
        class or are candidates. `parameters`: true values and estimates, with the `rank` of the true one.
        `phase_right`: whether an effect acts in the phase in which the gap is largest. `error_closed`: the share of
        whole tosses' position errors that the changes close. What does not apply is None.
    """
    kind, true = truth["case"]["kind"], truth["effects"]
    found = {finding["name"]: finding for finding in gap["effects"]}
    explanation = gap["explanation"]
    named = explanation["effects"]
    minor = [name for name in explanation["minor"] if found[name]["verdict"] != "candidate"]
    classes = {name: [name, *found[name]["confusable_with"]] for name in (*named, *minor)}
    candidates = {name: [name, *found[name]["confusable_with"]] for name in explanation["candidates"]}
    inside = {t: any(t in group[:LARGEST_CLASS] for group in classes.values()) for t in true}
    maybe = {t: inside[t] or any(t in group[:LARGEST_CLASS] for group in candidates.values()) for t in true}
    of_library = kind in OF_LIBRARY
    false = [name for name in named if not (of_library and set(classes[name]) & set(true))]
    first = next(iter(classes.values()), [])
    if kind == "without":
        right = explanation["verdict"] != "explained"
    elif not of_library:
        right = not named
    elif kind in SEVERAL:
        right = sum(inside.values()) >= SEVERAL_NAMED * len(true) and not false
    elif kind in PAIRS:
        right = all(inside.values())
    else:
        right = bool(set(first) & set(true)) and len(first) <= LARGEST_CLASS
    freedom = max(1.0, gap["n_tosses"] - sum(len(found[name]["parameters"]) for name in named))
    estimated = [name for name in true if of_library and inside[name]]
    return {
        "kind": kind,
        "right": right,
        "right_or_candidate": all(maybe.values()) if of_library else None,
        "verdict": explanation["verdict"],
        "classes": classes,
        "minor": minor,
        "candidates": candidates,
        "false": false,
        "missed": [name for name, there in inside.items() if not there],
        "parameters": [each for name in estimated for each in _parameters(name, true[name], found[name], freedom)],
        "gap_closed": explanation["gap_closed"]["value"] if of_library else None,
        "error_closed": _error_closed(gap["brings"]["position_error_pct"]) if of_library else None,
        "phase_right": _phase_right(true, gap["gap"]["by_phase"]) if of_library else None,
    }


def _parameters(
    name: str, true: Mapping[str, float], finding: Mapping[str, Any], freedom: float
) -> list[dict[str, Any]]:
    """True values of an effect beside their estimates, as far as they were fitted."""
    out = []
    for key, value in true.items():
        if key in finding["parameters"]:
            stated = finding["parameters"][key]
            low, high = stated["ci95"]
            covered = low is not None and high is not None and low <= value <= high
            about = {"effect": name, "name": key, "true": value, **stated}
            out.append({**about, "covered": covered, "rank": rank(value, stated, freedom)})
    return out


def _error_closed(error: Mapping[str, Any]) -> float | None:
    """The share of an error that is closed; None where there was none that a person would notice."""
    before, after = error["before"], error["after"]
    return None if before is None or after is None or before <= FELT_PCT else 1 - after / before


def _phase_right(names: Mapping[str, Any], by_phase: Sequence[Mapping[str, Any]]) -> bool | None:
    known = [each for each in by_phase if each["share"] is not None]
    if not known:
        return None
    largest = max(known, key=lambda each: each["share"])["phase"]
    return largest in {Phase(p).name.lower() for name in names for p in effect_named(name).phases}


def summarise(scores: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """The measures of an audit over scored cases.

    Args:
        scores: What `score` returned for each case.

    Returns:
        By measure, the `count` `of` how many and its `share`, or a `value` of so many; and what is `wanted`.
    """
    of = {kind: [s for s in scores if s["kind"] == kind] for kind in get_args(CaseKind)}
    unnamed = {kind: [not s["false"] for s in of[kind]] for kind in ("outside", "without")}
    unexplained = {kind: [s["verdict"] != "explained" for s in of[kind]] for kind in ("outside", "without")}
    ranks = [[p["rank"] for p in s["parameters"] if p["rank"] is not None] for s in scores]
    flat = [each for some in ranks for each in some]
    counted: dict[str, Sequence[bool]] = {
        "right_name": [s["right"] for s in of["effect"]],
        "right_or_candidate": [s["right_or_candidate"] for s in of["effect"]],
        "false_names_on_nulls": [bool(s["false"]) for s in of["null"]],
        "candidates_on_nulls": [bool(s["false"] or s["candidates"]) for s in of["null"]],
        "further_false_names": [bool(s["false"]) for s in of["effect"]],
        "coverage": [p["covered"] for s in scores for p in s["parameters"]],
        "coverage_90": within(flat, 0.9),
        "coverage_50": within(flat, 0.5),
        "pairs_both_named": [s["right"] for kind in PAIRS for s in of[kind]],
        **{f"{kind}_right": [s["right"] for s in of[kind]] for kind in SEVERAL},
        **{f"{kind}_not_named": values for kind, values in unnamed.items()},
        **{f"{kind}_not_explained": values for kind, values in unexplained.items()},
        "phases_right": [s["phase_right"] for s in scores if s["phase_right"] is not None],
    }
    medians = {key: [s[key] for s in scores if s[key] is not None] for key in ("gap_closed", "error_closed")}
    out = {name: _counted(values) for name, values in counted.items()}
    out |= {key: {"value": float(np.median(x)) if x else None, "of": len(x)} for key, x in medians.items()}
    out["ranks_uniform"] = {"value": uniform_p(ranks), "of": sum(bool(some) for some in ranks)}
    return {name: {**out[name], "wanted": wanted} for name, (_, wanted) in MEASURES.items()}


def _counted(values: Sequence[bool]) -> dict[str, Any]:
    n = len(values)
    return {"count": int(sum(values)), "of": n, "share": sum(values) / n if n else None}
