"""Cases are counted by what changes in them."""

from __future__ import annotations

from typing import Any

from pipelines.tools.experiments.changes_over_order import by_kind, measures
from tossid.diagnosis.audit.over_order import score_over_order


def score(form: str, effects: tuple[str, ...] = (), **what: Any) -> dict[str, Any]:
    none = {"moment_right": None, "right": True, "form_right": None, "further": []}
    return {"order": {"form": form}, "effects": dict.fromkeys(effects), **none, **what}


def test_rows_count_moments_names_and_forms() -> None:
    tilt = {"form_right": True, "moment_right": True}
    scores = [
        score("step", ("world_tilt",), **tilt),
        score("step", ("world_tilt",), **{**tilt, "moment_right": False, "further": ["wind"]}),
        score("drift", ("friction",), right=False, form_right=False),
        score("none"),
        score("none", right=False),
    ]
    assert by_kind(scores) == [
        ["world_tilt: step", "2", "1 of 2", "2 of 2", "1 of 2", "2 of 2"],
        ["friction: drift", "1", "", "0 of 1", "1 of 1", "0 of 1"],
        ["none", "2", "", "1 of 2", "", ""],
    ]


def test_measures_are_those_of_an_audit_that_are_of_changes() -> None:
    truth = {"case": {"order": {"form": "step", "at": 20}}, "effects": {"friction": {"mu": 0.3}}}
    scores = [
        score_over_order(truth, {"effects": [], "changes_left": [{"before": before}]}) for before in ("19", "21", "31")
    ]
    rows = {name: (found, of) for name, found, of in measures(scores)}
    assert rows["changes_found"] == ("2", "3")
    assert rows["changes_named"] == ("0", "3")
    assert rows["false_changes"] == ("0", "0")
    assert rows["drifts_named"] == ("0", "0")
