"""An audit's tables, figures and files say the same numbers."""

from __future__ import annotations

import json
from pathlib import Path

from tests.audit.answers import answer, truth
from tossid.audit.result import Audit
from tossid.audit.scores import MEASURES

FRICTION = truth("effect", friction={"mu": 0.3})
CASES = {
    "right": {
        "truth": FRICTION,
        "gap": answer("friction", minor=("wind",), friction={"parameters": {"mu": (0.29, 0.31, 0.33)}}),
    },
    "wrong": {"truth": FRICTION, "gap": answer("gravity", candidates=("friction",))},
    "null": {"truth": truth("null"), "gap": answer(verdict="no_gap", error=(None, None))},
}


def made() -> Audit:
    return Audit.of({name: {**case, "seconds": 2.0} for name, case in CASES.items()}, {"003-x": "it diverged"})


def test_rows_hold_what_was_there_and_what_was_named() -> None:
    right, wrong, null = made().case_table()
    named = "friction, wind (too small to matter)"
    assert right == ["right", "effect", "lcp", "friction mu=0.3", "40", named, "explained", "yes"]
    assert wrong[5:] == ["gravity", "explained", "NO"]
    assert null[3:] == ["nothing", "", "nothing", "no_gap", "yes"]


def test_tables_say_how_many_were_right() -> None:
    table = {words: rest for words, *rest in made().measure_table()}
    assert table[MEASURES["right_name"][0]] == ["1 of 2 (50 %)", "at least 95 %"]
    assert MEASURES["four_right"][0] not in table  # no such case
    *_, right, wrong, null = made().markdown().splitlines()
    assert right.endswith("| yes |  | 1 of 1 | 8.00, 0.40 |")
    assert wrong.endswith("| NO | friction |  | 8.00, 0.40 |")
    assert null.endswith("| yes |  |  |  |")
    assert "audit of 3 cases, 1 failed" in repr(made())
    assert "1 of 2" in made()._repr_html_()


def test_files_hold_the_rows(tmp_path: Path) -> None:
    paths = made().save(tmp_path)
    assert [path.name for path in paths] == ["detection.png"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)
    content = json.loads((tmp_path / "audit.json").read_text())
    assert content["summary"] == made().summary
    assert content["failed"] == {"003-x": "it diverged"}
    assert [row["right"] for row in content["cases"]] == [True, False, True]
    assert (tmp_path / "table.md").read_text() == made().markdown()
