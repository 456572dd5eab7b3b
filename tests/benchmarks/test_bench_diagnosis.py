"""Figures of diagnoses stand beside those of the last release."""

from __future__ import annotations

import json

from benchmarks.bench_diagnosis import ANSWERS, CASES, HEADS, KEPT, as_release, rows

FIGURES = {"elapsed_s": 12.3, "cpu_s": 20.1, "gib": 0.5, "named": ["friction"]}


def test_figures_stand_beside_those_that_were_kept() -> None:
    found = {"a": {**FIGURES, "gap_s": 4.52, "suspect_s": 5.0, "search_s": 9.96}, "b": {**FIGURES, "named": []}}
    kept = json.loads(json.dumps(as_release({"a": {**FIGURES, "cpu_s": 46.0}})))
    first, second = rows(found, kept)
    assert first == ["a", "12", "4.5", "5.0", "10.0", "20", "0.50", "friction", "12", "46", "0.50", "friction"]
    assert second == ["b", "12", "-", "-", "-", "20", "0.50", "none", "-", "-", "-", "-"]
    assert len(HEADS) == len(first)
    assert kept["version"]
    assert kept["date"]
    assert kept["machine"]


def test_what_is_kept_is_of_the_cases_that_are_timed() -> None:
    kept = json.loads(KEPT.read_text(encoding="utf-8"))
    assert set(kept["cases"]) <= set(CASES)
    assert all(set(each) - set(ANSWERS) == set(FIGURES) for each in kept["cases"].values())
