"""How an audit's intervals compare with the scatter of its repeated searches, and what they cover with it.

    python -m pipelines.tools.experiments.simulated.scatter AUDIT_FOLDER ...

For each parameter of a named true effect: 1.96 standard deviations of its values over the repeats that name the effect,
over the half width of its interval. Then how many intervals hold the true value, as they are stated and no narrower
than that scatter. (Since intervals are stated so, the second changes nothing for later audits.)
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tossid.diagnosis.selection.stability import Repeat, Stability
from tossid.physics.effects import effect_named
from tossid.settings.diagnosis.diagnose import StabilitySettings


@dataclass(frozen=True)
class Compared:
    """A parameter's interval beside the scatter of repeats.

    Attributes:
        case: Name of the case.
        parameter: Of which effect, and which.
        ratio: 1.96 standard deviations over repeats, over the interval's half width.
        covers: Whether the interval holds the true value.
        covers_widened: Whether it does if it is no narrower than the scatter.
    """

    case: str
    parameter: str
    ratio: float
    covers: bool
    covers_widened: bool


def compared(folder: Path, settings: StabilitySettings = StabilitySettings()) -> Iterator[Compared]:
    """The parameters of an audit's cases.

    Args:
        folder: Of the audit.
        settings: Of repeats.
    """
    for path in sorted(folder.glob("cases/*/result.json")):
        gap = json.loads((path.parent / "gap.json").read_text())
        score = json.loads(path.read_text())["score"]
        repeats = Stability(tuple(_repeat(each) for each in gap["explanation"]["repeated"]))
        saturated = {each["name"] for each in gap["effects"] if each.get("saturated")}
        for each in score["parameters"]:
            name, key = each["effect"], each["name"]
            scatter = repeats.scatter(effect_named(name), gap["explanation"]["hypothesis"], settings.fewest_values)
            if not scatter or name in saturated or None in each["ci95"]:
                continue
            low, high = each["ci95"]
            holds = each["covered"] or abs(each["true"] - each["value"]) <= scatter[key]
            yield Compared(path.parent.name, f"{name}.{key}", 2 * scatter[key] / (high - low), each["covered"], holds)


def _repeat(entry: dict[str, Any]) -> Repeat:
    nameless = tuple(entry.get("nameless", ()))
    return Repeat(tuple(entry["effects"]), entry["closed"], parameters=entry["effects"], nameless=nameless)


def table(rows: Sequence[Compared]) -> str:
    """A line for each parameter, and the sums.

    Args:
        rows: The parameters.
    """
    lines = [
        "| case | parameter | scatter over interval | covers | no narrower than the scatter |",
        "|---|---|---|---|---|",
    ]
    lines += [f"| {r.case} | {r.parameter} | {r.ratio:.2f} | {r.covers} | {r.covers_widened} |" for r in rows]
    if rows:
        of, wider = len(rows), sum(r.ratio > 1 for r in rows)
        covers, widened = sum(r.covers for r in rows), sum(r.covers_widened for r in rows)
        median = float(np.median([r.ratio for r in rows]))
        lines += [
            "",
            f"{wider} of {of} values scatter beyond their interval (median ratio {median:.2f}). "
            f"{covers} of {of} intervals hold, and {widened} if they are no narrower than the scatter.",
        ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.stdout.write(table([row for folder in sys.argv[1:] for row in compared(Path(folder))]) + "\n")
