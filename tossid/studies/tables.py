"""Statistics and tables of a study: many trainings and their evaluations, means over seeds with intervals over tosses.

A row is what one cell of a study gives:
`{"model", "seed", the swept value by name, **Scores.as_json(), "validation_loss", "seconds"}`.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from tossid.evaluation.evaluate import PARTS
from tossid.evaluation.metrics import depths
from tossid.html import number_words
from tossid.objects import GRAVITY, ObjectModel
from tossid.physics.identifiable import base_parameters, order
from tossid.settings.training import ModelSettings
from tossid.types import Toss

Row = Mapping[str, Any]

SWEPT = {
    "gravity": "given gravity [m/s²]",
    "tosses": "training tosses",
    "start_inertia": "start: inertia / true",
    "hidden": "hidden units",
}
"""What a swept value is called in a table's head."""
PLAIN = ("n_tosses", "unsolved", "diverged", "epochs", "seconds", "validation_loss", "run")
"""A row's numbers that are no metrics with intervals."""


def study_row(
    about: Mapping[str, Any],
    scores: Mapping[str, Any],
    history: Sequence[Mapping[str, Any]],
    *,
    settings: ModelSettings,
    truth: ObjectModel,
) -> dict[str, Any]:
    """A cell of a study as tables and figures take it.

    Args:
        about: Its model, its seed and the swept value, by name.
        scores: Of `Scores.as_json()`, and the seconds that training took.
        history: Epoch records as dicts, in order.
        settings: Of the model.
        truth: The dataset's object; learned inertia is compared with it where its start was swept.
    """
    inertial = "start_inertia" in about and "inertia_kgm2" in scores["parameters"]
    errors = inertia_errors(settings, scores["parameters"], truth) if inertial else {}
    return {**about, **scores, **errors, "validation_loss": validation_loss(history)}


def _by_value(cells: Sequence[Row], swept: str) -> Iterator[tuple[str, float, list[Row]]]:
    """Model, swept value, and the cells of all seeds with these."""
    for model, value in dict.fromkeys((cell["model"], cell[swept]) for cell in cells):
        yield model, value, [cell for cell in cells if (cell["model"], cell[swept]) == (model, value)]


def csv_table(cells: Sequence[Row], swept: str) -> str:
    """The cells as CSV: a row each, for every metric its mean and the ends of its 95 % interval."""
    rows = []
    for cell in cells:
        row = {name: cell[name] for name in ("model", "seed", swept)}
        for prefix, metrics in (("", cell), *((f"{part}.", cell.get(part, {})) for part in PARTS)):
            for name, value in metrics.items():
                if isinstance(value, dict) and "ci95" in value:
                    ends = zip(("mean", "low", "high"), (value["mean"], *value["ci95"]), strict=True)
                    row |= {f"{prefix}{name}.{end}": number for end, number in ends}
        rows.append(row | {n: cell[n] for n in (*PLAIN, "inertia_error_rel", "com_error_m") if n in cell})
    text = io.StringIO()
    writer = csv.DictWriter(text, list(dict.fromkeys(name for row in rows for name in row)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def markdown_table(cells: Sequence[Row], swept: str) -> str:
    """A markdown row for each model and swept value: means over seeds of the metrics and of their intervals' ends."""
    inertial, jointed, short = (
        all(name in cell for cell in cells) for name in ("inertia_error_rel", "joint_error_deg", "sixteen_steps")
    )
    lines: list[dict[str, str]] = []
    for model, value, same in _by_value(cells, swept):
        # by column; a part's name in front keeps equal heads apart, and is left out of the head
        row = {"model": f"`{model}`", SWEPT.get(swept, swept): f"{value:g}"}
        if inertial:
            row["inertia off by [%]"] = _range([100 * c["inertia_error_rel"] for c in same])
            row["centre of mass off by [mm]"] = _range([1e3 * c["com_error_m"] for c in same])
        if swept == "gravity":
            found, missing = float(np.mean([c["gravity_ms2"]["mean"] for c in same])), GRAVITY - value
            row["gravity found [m/s²]"] = f"{found:.2f}"
            share = f"{100 * (found - value) / missing:.1f}" if abs(missing) > 1e-6 else "-"
            row["of what was missing [%]"] = share
        flown = [c["from_flight"] for c in same if "from_flight" in c]
        row["position [%]"] = _metric(same, "position_error_pct")
        row["rotation [deg]"] = _metric(same, "rotation_error_deg")
        row["penetration [mm]"] = _metric(same, "penetration_mm", digits=2, ends=False)
        row["from flight: position [%]"] = _metric(flown, "position_error_pct")
        row["flight|rotation [deg]"] = _metric(flown, "rotation_error_deg")
        if jointed:
            row["joint [deg]"] = _metric(same, "joint_error_deg")
            row["acceleration in flight off by [%]"] = _metric(same, "flight_miss_pct", digits=2, ends=False)
        if short:
            cut = [c["sixteen_steps"] for c in same]
            row["16 steps: position [%]"] = _metric(cut, "position_error_pct", digits=2)
            row["16 steps|rotation [deg]"] = _metric(cut, "rotation_error_deg", digits=2)
            if jointed:
                row["16 steps|joint [deg]"] = _metric(cut, "joint_error_deg", digits=2)
        row["validation loss"] = f"{np.mean([c['validation_loss'] for c in same]):.4g}"
        row["seconds"] = f"{np.mean([c['seconds'] for c in same]):.0f}"
        lines.append(row)
    head = [name.rpartition("|")[2] for name in lines[0]]
    return "".join(f"| {' | '.join(line)} |\n" for line in (head, ["---"] * len(head), *(r.values() for r in lines)))


def _metric(cells: Sequence[Row], name: str, *, digits: int = 1, ends: bool = True) -> str:
    values = [cell[name] for cell in cells if cell[name]["mean"] is not None]
    if not values:
        return "-"
    mean, low, high = np.mean([(value["mean"], *value["ci95"]) for value in values], axis=0)
    text, low, high = (f"{round(x, digits) + 0.0:.{digits}f}" for x in (mean, low, high))
    return f"{text} ({low} to {high})" if ends and low != high else text


def _range(values: Sequence[float]) -> str:
    """One number, or over seeds the least and the largest."""
    low, high = min(values), max(values)
    return f"{low:.2g}" if len(values) == 1 else f"{low:.2g} to {high:.2g}"


def seed_means(cells: Sequence[Row], swept: str) -> tuple[list[str], list[list[str]]]:
    """Head and rows of a short table: means over seeds of the main metrics."""
    metrics = ["gravity_ms2", "position_error_pct", "rotation_error_deg", "penetration_mm"]
    if all("inertia_error_rel" in cell for cell in cells):
        metrics = ["inertia_error_rel", "com_error_m", *metrics[1:3]]
    rows = []
    for model, value, same in _by_value(cells, swept):
        found = [[c[name]["mean"] if isinstance(c[name], dict) else c[name] for c in same] for name in metrics]
        known = [[number for number in part if number is not None] for part in found]
        rows.append([model, f"{value:g}", *[number_words(float(np.mean(part)), 3) if part else "-" for part in known]])
    return ["model", swept, *metrics], rows


def validation_loss(history: Sequence[Mapping[str, Any]]) -> float:
    """The lowest validation loss of the last stage of epoch records: that of the parameters that were kept."""
    return min(float(row["validation_loss"]) for row in history if row["stage"] == history[-1]["stage"])


def measured_penetration(tosses: Sequence[Toss], model: ObjectModel) -> float:
    """Mean over tosses of the recorded poses' own penetration, defined as the metric `penetration_mm` [mm]."""
    return float(np.mean([1e3 * depths(model, toss.q).mean() for toss in tosses]))


def inertia_errors(model: ModelSettings, parameters: Mapping[str, Any], truth: ObjectModel) -> dict[str, Any]:
    """How far a learned inertia is from the dataset's object's, and where training started from.

    Args:
        model: Settings of the training.
        parameters: What was learned, as of `Scores.as_json()`.
        truth: The dataset's object.

    Returns:
        inertia_error_rel: of a single body, the largest |I_learned / I_true - 1| over all axes, that is over the
        eigenvalues of I_true^-1 I_learned, both about the centre of mass. Of a tree, the largest error of the
        combinations of inertial parameters on which its motion depends (`physics.identifiable`), over the largest true
        one of their kind. com_error_m: distance of the centres of mass; of a tree, the largest error of a combination
        that is a first moment, over the total mass. com_offset_m: where training started from.
    """
    offset = float(np.linalg.norm(model.start_com))
    found: dict[str, Any] = {
        "parameterisation": model.inertia,
        "inertia_scale": model.start_inertia,
        "com_offset_m": offset,
    }
    inertia, com = np.array(parameters["inertia_kgm2"]), np.array(parameters["com_m"])
    if truth.n_bodies > 1:
        base = base_parameters(truth)
        learned = truth.with_changes(mass=np.array(parameters["mass_kg"]), com=com, inertia=inertia)
        error, off = base.errors(learned, truth), np.abs(base.values(learned) - base.values(truth))
        first = np.array([order(name) == 1 for name in base.names])
        worst = int(error.argmax())
        found |= {"inertia_error_rel": float(error[worst]), "inertia_worst": base.names[worst]}
        return found | {"com_error_m": float(off[first].max())}
    shares = np.linalg.eigvals(np.linalg.solve(truth.inertia[0], inertia[0])).real
    found["inertia_error_rel"] = float(np.abs(shares - 1).max())
    return found | {"com_error_m": float(np.linalg.norm(com[0] - truth.com[0]))}
