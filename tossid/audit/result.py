"""An audit's result: a row for each case, and how many were right."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from tossid.audit.cases import OF_LIBRARY
from tossid.audit.figures import detection
from tossid.audit.scores import MEASURES, score, summarise
from tossid.evaluation.figures.style import as_png
from tossid.html import html_table
from tossid.outputs import write_whole
from tossid.plain_json import jsonable

CASE_HEADINGS = ("case", "kind", "engine", "truth", "displacement / noise", "named", "verdict", "right")
MEASURE_HEADINGS = ("measure", "reached", "wanted")


@dataclass(frozen=True, repr=False)
class Audit:
    """What diagnoses found of effects that were withheld from them.

    Attributes:
        rows: A row for each case.
        summary: By measure, `count` or `value` `of` how many, the `share`, and what is `wanted`.
        failed: Cases that ended in an error, with its text.
    """

    rows: tuple[dict[str, Any], ...]
    summary: dict[str, dict[str, Any]]
    failed: dict[str, str]

    @classmethod
    def of(cls, cases: Mapping[str, Mapping[str, Any]], failed: Mapping[str, str]) -> Audit:
        """The audit of diagnosed cases.

        Args:
            cases: By name, the `truth`, the diagnosis (`gap`) and the `seconds` of a case.
            failed: Cases that ended in an error.
        """
        scores = {name: score(case["truth"], case["gap"]) for name, case in cases.items()}
        rows = tuple(row_of(name, case, scores[name]) for name, case in cases.items())
        return cls(rows, summarise(list(scores.values())), dict(failed))

    def figures(self) -> dict[str, Figure]:
        """The figures by name: the share of right names by displacement, if any case has an effect of the library."""
        rows = [row for row in self.rows if row["kind"] in OF_LIBRARY]
        return {"detection": detection(rows)} if rows else {}

    def case_table(self) -> list[list[str]]:
        """A row for each case, under `CASE_HEADINGS`."""
        return [_cells(row) for row in self.rows]

    def measure_table(self) -> list[list[str]]:
        """A row for each measure that any case has, under `MEASURE_HEADINGS`."""
        known = {name: value for name, value in self.summary.items() if value["of"]}
        return [[MEASURES[name][0], _reached(value), value["wanted"]] for name, value in known.items()]

    def markdown(self) -> str:
        """The measures and the cases as tables in Markdown."""
        headings = (*CASE_HEADINGS, "candidates", "intervals that cover", "position error before, after [%]")
        rows = [[*_cells(row), *_more_cells(row)] for row in self.rows]
        return f"{_markdown(MEASURE_HEADINGS, self.measure_table())}\n{_markdown(headings, rows)}"

    def as_json(self) -> dict[str, Any]:
        """The content of audit.json."""
        plain: dict[str, Any] = jsonable({"summary": self.summary, "cases": self.rows, "failed": self.failed})
        return plain

    def save(self, folder: str | Path) -> list[Path]:
        """Write audit.json, table.md and the figures; returns the figures' files.

        Args:
            folder: Where to; made if it is not there.

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
        first = f"audit of {len(self.rows)} cases, {len(self.failed)} failed"
        measures = [f"{words}: {found}" + f" (wanted: {aim})" * bool(aim) for words, found, aim in self.measure_table()]
        return "\n".join([first, *measures])

    def _repr_html_(self) -> str:
        return html_table(MEASURE_HEADINGS, self.measure_table())


def row_of(name: str, case: Mapping[str, Any], scored: Mapping[str, Any]) -> dict[str, Any]:
    """A case as a row, as audit.json has it.

    Args:
        name: Of the case.
        case: As of `Audit.of`.
        scored: Its score.
    """
    truth, error = case["truth"], case["gap"]["brings"]["position_error_pct"]
    return {
        "name": name,
        "engine": truth["case"]["engine"],
        "effects": truth["effects"],
        "displacement": list(truth["displacement"].values()),
        **scored,
        "position_error_pct": [error["before"], error["after"]],
        "seconds": case["seconds"],
    }


def _cells(row: Mapping[str, Any]) -> list[str]:
    effects = [
        " ".join([name, *(f"{key}={value:.3g}" for key, value in values.items())])
        for name, values in row["effects"].items()
    ]
    names = [
        "/".join(group) + (" (too small to matter)" if name in row["minor"] else "")
        for name, group in row["classes"].items()
    ]
    return [
        row["name"],
        row["kind"],
        row["engine"],
        "; ".join(effects) or "nothing",
        ", ".join(f"{x:.0f}" for x in row["displacement"]),
        ", ".join(names) or "nothing",
        row["verdict"],
        "yes" if row["right"] else "NO",
    ]


def _more_cells(row: Mapping[str, Any]) -> list[str]:
    covered = [p["covered"] for p in row["parameters"]]
    errors = [x for x in row["position_error_pct"] if x is not None]
    return [
        ", ".join("/".join(group) for group in row["candidates"].values()),
        f"{sum(covered)} of {len(covered)}" if covered else "",
        ", ".join(f"{x:.2f}" for x in errors),
    ]


def _reached(value: Mapping[str, Any]) -> str:
    if "value" in value:
        return f"{value['value']:.3f} (of {value['of']})"
    return f"{value['count']} of {value['of']} ({100 * value['share']:.0f} %)"


def _markdown(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [headings, ["---"] * len(headings), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
