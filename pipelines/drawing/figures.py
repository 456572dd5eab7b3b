"""Figures of a training, of an evaluation and of a study, as files: which are drawn, and where they lie."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tossid.outputs import output_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tossid.models import TrainedModel


def training_figures(trained: TrainedModel, *, name: str) -> dict[str, Figure]:
    """Curves over epochs, and the geometry before and after."""
    from tossid.evaluation.figures import learned_geometry, training_curves

    return {
        "training_curves": training_curves(trained.history, title=f"Training {name}"),
        "learned_geometry": learned_geometry(
            trained.model.object, trained.model.learned_object(), title=f"Geometry learned by {name}"
        ),
    }


def sweep_figures(key: str, cells: Sequence[dict[str, Any]], *, measured_penetration_mm: float) -> dict[str, Figure]:
    """The study's metrics against the swept value, from the first state and from the flight; {} for other keys."""
    from tossid.evaluation.figures import data_efficiency, gravity_sweep, inertia_study

    if key == "model.start_inertia":
        return {"inertia_study": inertia_study(cells)}
    starts = [False] + ([True] if all("from_flight" in cell for cell in cells) else [])
    figures: dict[str, Figure] = {}
    for from_flight in starts:
        suffix = "_from_flight" if from_flight else ""
        if key == "model.gravity":
            figures[f"gravity_sweep{suffix}"] = gravity_sweep(
                cells, measured_penetration_mm=measured_penetration_mm, from_flight=from_flight
            )
        elif key == "tosses":
            figures[f"data_efficiency{suffix}"] = data_efficiency(cells, swept="tosses", from_flight=from_flight)
    return figures


def write_figures(figures: dict[str, Figure], folder: Path) -> list[Path]:
    """Write each as NAME.png into the folder; returns the paths."""
    paths = []
    for name, figure in figures.items():
        path = folder / f"{name}.png"
        with output_file(path) as temporary:
            figure.savefig(temporary)
        paths.append(path)
    return paths
