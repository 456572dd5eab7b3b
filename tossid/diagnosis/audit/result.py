"""An audit's result: a row for each case, and how many were right."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from tossid.diagnosis.audit.figures import audit_figures
from tossid.diagnosis.audit.over_order import NONE, STEP
from tossid.diagnosis.audit.scores import summarise
from tossid.evaluation.figures.style import as_png
from tossid.html import html_table
from tossid.outputs import write_whole
from tossid.plain_json import jsonable
from tossid.settings.diagnosis.audit import ScoreSettings

MEASURES = {
    "right_name": "the right effect is named first, or in its class",
    "false_names_on_nulls": "an effect is named where there is none",
    "further_false_names": "a further effect is named that is not there",
    "coverage": "95 % intervals that hold the true value",
    "coverage_50": "intervals of 50 % that hold the true value",
    "coverage_90": "intervals of 90 % that hold the true value",
    "coverage_led": "95 % intervals that do, where the true effect leads its class",
    "coverage_behind": "95 % intervals that do, where it stands behind another name",
    "ranks_uniform": "probability of ranks of true values as uneven as these",
    "joint_ranks_uniform": "probability of ranks of whole effects as uneven as these",
    "closed_median": "closed share of the closable gap (median)",
    "pairs_both_named": "both effects of a pair are named",
    "four_found": "of four effects at once, an effect is named",
    "four_right": "of four effects at once, three are named, and none that is not there",
    "eight_found": "of eight effects at once, an effect is named",
    "eight_right": "of eight effects at once, six are named, and none that is not there",
    "outside_not_named": "no effect is named for a force outside the library",
    "outside_not_explained": "such a gap is not called explained",
    "without_not_explained": "without its effect in the library, a gap is not called explained",
    "phases_right": "the effect acts in the phase with the largest gap",
    "brier_names": "Brier score of the probabilities of names",
    "log_score_names": "logarithmic score of the probabilities of names",
    "brier_none": "Brier score of the probability of none of the library",
    "log_score_none": "logarithmic score of the probability of none of the library",
    "changes_found": "a change over the order is found, within three tosses of where it is",
    "changes_named": "the effect that changes is named as one that does",
    "drifts_named": "an effect that drifts is named as one that does",
    "drift_rate_off": "relative error of a drift's rate (median)",
    "false_changes": "something is said to change where nothing does",
    "spoilt_named": "the spoilt parameter is named",
    "spoilt_restored": "the spoilt parameter is restored",
}
"""The measures of an audit in words."""

CASE_HEADINGS = ("case", "kind", "engine", "truth", "displacement / noise", "named", "verdict", "right")
MEASURE_HEADINGS = ("measure", "reached", "wanted")


@dataclass(frozen=True, repr=False)
class Audit:
    """What diagnoses found of effects that were withheld from them.

    Attributes:
        rows: A row for each case.
        summary: By measure, `count` or `value` `of` how many, the `share`, and what is `wanted`.
        failed: Cases that ended in an error, with its text.
        settings: What was wanted.
    """

    rows: tuple[dict[str, Any], ...]
    summary: dict[str, dict[str, Any]]
    failed: dict[str, str]
    settings: ScoreSettings = ScoreSettings()

    @classmethod
    def of(cls, results: Sequence[Mapping[str, Any]], failed: Mapping[str, str], settings: ScoreSettings) -> Audit:
        """The audit of scored cases.

        Args:
            results: Results of `run_case`.
            failed: Cases that ended in an error.
            settings: What is wanted.

        Returns:
            The audit.
        """
        summary = summarise([result["score"] for result in results], settings=settings)
        return cls(tuple(row_of(result) for result in results), summary, dict(failed), settings)

    def figures(self) -> dict[str, Figure]:
        """The figures, by name.

        Returns:
            The confusion matrix, the share of right names by displacement, the ranks of true values within what is
            stated of them, and the reliability of probabilities.
        """
        return audit_figures(self.rows, settings=self.settings)

    def case_table(self) -> list[list[str]]:
        """The cases as a table under `CASE_HEADINGS`.

        Returns:
            A row for each case.
        """
        keys = ("name", "kind", "engine", "truth", "moves", "named", "verdict")
        return [[*(str(row[key]) for key in keys), _yes(row)] for row in self.rows]

    def measure_table(self) -> list[list[str]]:
        """The measures as a table under `MEASURE_HEADINGS`.

        Returns:
            A row for each measure.
        """
        return [[MEASURES.get(name, name), *_in_words(value)] for name, value in self.summary.items()]

    def markdown(self) -> str:
        """The cases as a Markdown table.

        Returns:
            The text.
        """
        lines = ["| " + " | ".join((*CASE_HEADINGS, "closed", "covered")) + " |"]
        lines.append("|" + " --- |" * (len(CASE_HEADINGS) + 2))
        for row, cells in zip(self.rows, self.case_table(), strict=True):
            closed = "" if row["closed"] is None else f"{row['closed']:.2f}"
            covered = f"{sum(row['covered'])} of {len(row['covered'])}"
            lines.append("| " + " | ".join([*cells, closed, covered]) + " |")
        return "\n".join(lines) + "\n"

    def as_json(self) -> dict[str, Any]:
        """The content of audit.json.

        Returns:
            Plain values.
        """
        plain: dict[str, Any] = jsonable({"summary": self.summary, "cases": self.rows, "failed": self.failed})
        return plain

    def save(self, folder: str | Path) -> list[Path]:
        """Write audit.json, table.md and the figures.

        Args:
            folder: Where to; made if it is not there.

        Returns:
            The figures' files.

        Raises:
            OutputError: The disk refuses.
        """
        folder, paths = Path(folder), []
        for name, figure in self.figures().items():
            paths.append(folder / "figures" / f"{name}.png")
            write_whole(paths[-1], as_png(figure))
        write_whole(folder / "table.md", self.markdown().encode())
        content = {**self.as_json(), "figures": [str(path) for path in paths]}
        write_whole(folder / "audit.json", (json.dumps(content, indent=1, allow_nan=False) + "\n").encode())
        return paths

    def __repr__(self) -> str:
        lines = [
            f"{name}: {found}" + (f" (wanted {wanted})" if wanted else "") for name, found, wanted in self._found()
        ]
        return "\n".join([f"audit of {len(self.rows)} cases, {len(self.failed)} failed", *lines])

    def _repr_html_(self) -> str:
        return html_table(MEASURE_HEADINGS, self._found())

    def _found(self) -> list[list[str]]:
        """The measures that any case has."""
        return [row for row, value in zip(self.measure_table(), self.summary.values(), strict=True) if value["of"]]


def row_of(result: Mapping[str, Any]) -> dict[str, Any]:
    """A case as a row.

    Args:
        result: The result of `run_case`.

    Returns:
        The row, as audit.json has it.
    """
    case, scored, effects = result["truth"]["case"], result["score"], result["truth"]["effects"]
    reached = list(result["truth"]["displacement"].values())
    first: list[str] = next(iter(scored["classes"].values()), [])
    return {
        "name": result["name"],
        "kind": case["kind"],
        "engine": case["engine"],
        "effects": list(effects),
        "truth": "; ".join(f"{name} {_values(values)}" for name, values in effects.items()) + _when(case) or "nothing",
        "changing": scored.get("changing", {}),
        "displacement": reached,
        "moves": ", ".join(f"{x:.0f}" for x in reached),
        "named": ", ".join("/".join(group) + _minor(scored, name) for name, group in scored["classes"].items())
        or "nothing",
        "first": next(iter(scored["classes"]), None),
        "class": first,
        "verdict": scored["verdict"],
        "right": scored["right"],
        "phase_right": scored["phase_right"],
        "claims": scored["claims"],
        "closed": scored["closed"],
        "covered": [p["covered"] for p in scored["parameters"]],
        "parameters": scored["parameters"],
        "joint_ranks": scored["joint_ranks"],
        "seconds": result["seconds"],
    }


def _minor(scored: Mapping[str, Any], name: str) -> str:
    return " (too small to matter)" if name in scored.get("minor", ()) else ""


def _when(case: Mapping[str, Any]) -> str:
    order = case.get("order")
    if order is None or order["form"] == NONE:
        return ""
    return f", from toss {order['at']} on" if order["form"] == STEP else ", reached by a drift"


def _values(values: Mapping[str, float]) -> str:
    return " ".join(f"{key}={value:.3g}" for key, value in values.items())


def _yes(row: Mapping[str, Any]) -> str:
    return "yes" if row["right"] else "NO"


def _in_words(value: Mapping[str, Any]) -> list[str]:
    wanted = value.get("wanted")
    if "value" in value:
        text = "none" if value["value"] is None else f"{value['value']:.3f} (of {value['of']})"
    else:
        text = f"{value['count']} of {value['of']}"
    return [text, "" if wanted is None else f"{wanted:g}"]
