"""Figures as files, and which a training has."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

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


def write_figures(figures: dict[str, Figure], folder: Path) -> list[Path]:
    """Write each as NAME.png into the folder; returns the paths."""
    paths = []
    for name, figure in figures.items():
        path = folder / f"{name}.png"
        with output_file(path) as temporary:
            figure.savefig(temporary)
        paths.append(path)
    return paths
