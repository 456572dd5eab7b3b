"""Truths and diagnoses made by hand, in the form of truth.json and gap.json."""

from __future__ import annotations

from typing import Any


def truth(kind: str, **effects: dict[str, float]) -> dict[str, Any]:
    case = {"kind": kind, "seed": 0, "engine": "lcp"}
    return {"case": case, "effects": effects, "displacement": dict.fromkeys(effects, 40.0)}


def answer(
    *named: str,
    candidates: tuple[str, ...] = (),
    minor: tuple[str, ...] = (),
    verdict: str = "explained",
    error: tuple[float | None, float | None] = (8.0, 0.4),
    **found: Any,
) -> dict[str, Any]:
    """gap.json as far as an audit reads it. found: NAME={"classes": (…), "parameters": {KEY: (low, value, high)}}."""
    effects = []
    for name in dict.fromkeys([*named, *candidates, *minor, *found]):
        about = found.get(name, {})
        parameters = {k: {"value": v, "ci95": [lo, hi]} for k, (lo, v, hi) in about.get("parameters", {}).items()}
        sure = about.get("verdict", "candidate" if name in candidates else "identified")
        classes = list(about.get("classes", ()))
        effects.append({"name": name, "verdict": sure, "confusable_with": classes, "parameters": parameters})
    return {
        "n_tosses": 20,
        "gap": {"by_phase": [{"phase": "flight", "share": 0.2}, {"phase": "impact", "share": 0.8}]},
        "effects": effects,
        "brings": {"position_error_pct": {"before": error[0], "after": error[1]}},
        "explanation": {
            "verdict": verdict,
            "effects": list(named),
            "candidates": list(candidates),
            "minor": list(minor),
            "gap_closed": {"value": 0.9},
        },
    }
