"""Cases are counted by what changes in them."""

from __future__ import annotations

from typing import Any

from pipelines.tools.experiments.changes_over_order import by_kind


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
