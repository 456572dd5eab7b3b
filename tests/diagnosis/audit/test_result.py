"""An audit's tables, figures and files say the same numbers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tossid.diagnosis.audit.result import MEASURES, Audit, row_of
from tossid.diagnosis.audit.scores import score, summarise
from tossid.settings.diagnosis.audit import ScoreSettings


def result(kind: str, named: str | None) -> dict[str, Any]:
    truth = {
        "case": {"kind": kind, "engine": "lcp", "seed": 0},
        "effects": {"friction": {"mu": 0.3}} if kind == "effect" else {},
        "displacement": {"friction": 40.0} if kind == "effect" else {},
    }
    parameters = {"mu": {"value": 0.31, "ci95": [0.29, 0.33]}}
    effect = {"name": named, "confusable_with": [], "parameters": parameters, "correlation": [[1.0]]}
    gap = {
        "gap": {"by_phase": [{"phase": "slide", "share": 1.0}]},
        "effects": [effect | {"evidence": {"n_tosses": 20.0}}] if named else [],
        "explanation": {
            "verdict": "explained" if named else "no_gap",
            "effects": [named] if named else [],
            "gap_closed": {"value": 0.9},
            "unexplained_where": [],
        },
    }
    return {"name": f"{kind}-{named}", "truth": truth, "score": score(truth, gap, closable=1.0), "seconds": 2.0}


RESULTS = [result("effect", "friction"), result("effect", "gravity"), result("null", None)]


def made() -> Audit:
    return Audit.of(RESULTS, {"003-x": "it diverged"}, ScoreSettings())


def test_rows_hold_what_was_there_and_what_was_named() -> None:
    row = row_of(RESULTS[0])
    assert (row["truth"], row["named"], row["moves"], row["right"]) == ("friction mu=0.3", "friction", "40", True)
    assert row["covered"] == [True]
    assert row_of(RESULTS[2])["truth"] == "nothing"


def test_every_measure_has_words() -> None:
    assert set(summarise([], settings=ScoreSettings())) <= set(MEASURES)


def test_tables_say_how_many_were_right() -> None:
    table = {name: rest for name, *rest in made().measure_table()}
    assert table[MEASURES["right_name"]] == ["1 of 2", "0.9"]
    lines = made().markdown().splitlines()
    assert len(lines) == 2 + len(RESULTS)
    assert "| yes |" in lines[2]
    assert "| NO |" in lines[3]
    assert "audit of 3 cases, 1 failed" in repr(made())
    assert "1 of 2" in made()._repr_html_()


def test_files_hold_the_rows(tmp_path: Path) -> None:
    paths = made().save(tmp_path)
    assert [path.name for path in paths] == ["confusion.png", "detection.png", "ranks.png"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)
    content = json.loads((tmp_path / "audit.json").read_text())
    assert content["summary"] == made().summary
    assert content["failed"] == {"003-x": "it diverged"}
    assert (tmp_path / "table.md").read_text() == made().markdown()
