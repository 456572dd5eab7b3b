"""Statistics and tables of a study: many trainings and their evaluations, means over seeds with intervals over tosses.

A row is what one cell of a study gives:
`{"model", "seed", the swept value by name, **Scores.as_json(), "validation_loss", "seconds"}`.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tossid.objects import GRAVITY, ObjectModel, corner_heights
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


def csv_table(cells: Sequence[Row], swept: str) -> str:
    """The cells as CSV: a row each, for every metric its mean and the ends of its 95 % interval.

    Args:
        cells: Of the study.
        swept: The name of the swept value in a cell.
    """
    rows = []
    for cell in cells:
        row = {"model": cell["model"], "seed": cell["seed"], swept: cell[swept]}
        for prefix, metrics in (
            ("", cell),
            ("from_flight.", cell.get("from_flight", {})),
            ("sixteen_steps.", cell.get("sixteen_steps", {})),
        ):
            for name, value in metrics.items():
                if isinstance(value, dict) and "ci95" in value:
                    ends = zip(("mean", "low", "high"), (value["mean"], *value["ci95"]), strict=True)
                    row |= {f"{prefix}{name}.{end}": number for end, number in ends}
        known = ("n_tosses", "unsolved", "diverged", "epochs", "seconds", "validation_loss", "run")
        row |= {name: cell[name] for name in (*known, "inertia_error_rel", "com_error_m") if name in cell}
        rows.append(row)
    text = io.StringIO()
    writer = csv.DictWriter(text, list(dict.fromkeys(name for row in rows for name in row)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def markdown_table(cells: Sequence[Row], swept: str) -> str:
    """A markdown row for each model and swept value: means over seeds of the metrics and of their intervals' ends.

    Args:
        cells: Of the study.
        swept: The name of the swept value in a cell.
    """
    head = ["model", SWEPT.get(swept, swept)]
    inertial = all("inertia_error_rel" in cell for cell in cells)
    if inertial:
        head += ["inertia off by [%]", "centre of mass off by [mm]"]
    if swept == "gravity":
        head += ["gravity found [m/s²]", "of what was missing [%]"]
    head += ["position [%]", "rotation [deg]", "penetration [mm]", "from flight: position [%]", "rotation [deg]"]
    jointed = all("joint_error_deg" in cell for cell in cells)
    short = all("sixteen_steps" in cell for cell in cells)
    head += ["joint [deg]", "acceleration in flight off by [%]"] if jointed else []
    head += ["16 steps: position [%]", "rotation [deg]"] if short else []
    head += ["joint [deg]"] if jointed and short else []
    head += ["validation loss", "seconds"]
    lines = [head, ["---"] * len(head)]
    for model, value in dict.fromkeys((cell["model"], cell[swept]) for cell in cells):
        same = [cell for cell in cells if (cell["model"], cell[swept]) == (model, value)]
        row = [f"`{model}`", f"{value:g}"]
        if inertial:
            row += [
                _range([100 * c["inertia_error_rel"] for c in same]),
                _range([1e3 * c["com_error_m"] for c in same]),
            ]
        if swept == "gravity":
            found = float(np.mean([c["gravity_ms2"]["mean"] for c in same]))
            missing = GRAVITY - value
            row += [f"{found:.2f}", f"{100 * (found - value) / missing:.1f}" if abs(missing) > 1e-6 else "-"]
        flown = [c["from_flight"] for c in same if "from_flight" in c]
        row += [_metric(same, "position_error_pct"), _metric(same, "rotation_error_deg")]
        row += [_metric(same, "penetration_mm", digits=2, ends=False)]
        row += [_metric(flown, "position_error_pct"), _metric(flown, "rotation_error_deg")]
        if jointed:
            row += [_metric(same, "joint_error_deg"), _metric(same, "flight_miss_pct", digits=2, ends=False)]
        if short:
            cut = [c["sixteen_steps"] for c in same]
            keys = ("position_error_pct", "rotation_error_deg", *(("joint_error_deg",) if jointed else ()))
            row += [_metric(cut, key, digits=2) for key in keys]
        row += [f"{np.mean([c['validation_loss'] for c in same]):.4g}", f"{np.mean([c['seconds'] for c in same]):.0f}"]
        lines.append(row)
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _metric(cells: Sequence[Row], name: str, *, digits: int = 1, ends: bool = True) -> str:
    values = [cell[name] for cell in cells if cell[name]["mean"] is not None]
    if not values:
        return "-"
    mean, low, high = np.mean([(value["mean"], *value["ci95"]) for value in values], axis=0)
    return f"{mean:.{digits}f}" + (f" ({low:.{digits}f} to {high:.{digits}f})" if ends else "")


def _range(values: Sequence[float]) -> str:
    """One number, or over seeds the least and the largest."""
    low, high = min(values), max(values)
    return f"{low:.2g}" if len(values) == 1 else f"{low:.2g} to {high:.2g}"


def validation_loss(history: Sequence[Mapping[str, Any]]) -> float:
    """The lowest validation loss of the last stage: that of the parameters that were kept.

    Args:
        history: Epoch records as dicts, in order.
    """
    return min(float(row["validation_loss"]) for row in history if row["stage"] == history[-1]["stage"])


def measured_penetration(tosses: Sequence[Toss], model: ObjectModel) -> float:
    """Mean over tosses of the measured motions' own penetration, defined as the metric `penetration_mm` [mm].

    Args:
        tosses: As recorded.
        model: The object as it is stated.
    """
    lowest = [corner_heights(model, toss.q).min(axis=1) for toss in tosses]
    return float(np.mean([1e3 * np.maximum(-height, 0).mean() for height in lowest]))


def seed_means(cells: Sequence[Row], swept: str) -> tuple[list[str], list[list[str]]]:
    """Head and rows of a short table: means over seeds of the main metrics.

    Args:
        cells: Of the study.
        swept: The name of the swept value in a cell.
    """
    metrics = ["gravity_ms2", "position_error_pct", "rotation_error_deg", "penetration_mm"]
    if all("inertia_error_rel" in cell for cell in cells):
        metrics = ["inertia_error_rel", "com_error_m", *metrics[1:3]]
    rows = []
    for model, value in dict.fromkeys((cell["model"], cell[swept]) for cell in cells):
        same = [cell for cell in cells if (cell["model"], cell[swept]) == (model, value)]
        found = [[c[name]["mean"] if isinstance(c[name], dict) else c[name] for c in same] for name in metrics]
        known = [[number for number in part if number is not None] for part in found]
        rows.append([model, f"{value:g}", *[f"{np.mean(part):.3g}" if part else "-" for part in known]])
    return ["model", swept, *metrics], rows


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
    start = {
        "parameterisation": model.inertia,
        "inertia_scale": model.start_inertia,
        "com_offset_m": float(np.linalg.norm(model.start_com)),
    }
    inertia, com = np.array(parameters["inertia_kgm2"]), np.array(parameters["com_m"])
    if truth.n_bodies > 1:
        base = base_parameters(truth)
        learned = truth.with_changes(mass=np.array(parameters["mass_kg"]), com=com, inertia=inertia)
        error = base.errors(learned, truth)
        off = np.abs(base.values(learned) - base.values(truth))
        first = np.array([order(name) == 1 for name in base.names])
        worst = int(error.argmax())
        return {
            **start,
            "inertia_error_rel": float(error[worst]),
            "inertia_worst": base.names[worst],
            "com_error_m": float(off[first].max()),
        }
    shares = np.linalg.eigvals(np.linalg.solve(truth.inertia[0], inertia[0])).real
    return {
        **start,
        "inertia_error_rel": float(np.abs(shares - 1).max()),
        "com_error_m": float(np.linalg.norm(com[0] - truth.com[0])),
    }
