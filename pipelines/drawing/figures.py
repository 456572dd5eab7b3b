"""Figures as files, and which a training has."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tossid.outputs import output_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from tossid.models import TrainedModel


def training_figures(trained: TrainedModel, *, name: str) -> dict[str, Figure]:
    """Curves over epochs, and the geometry before and after."""
    from tossid.evaluation.figures import learned_geometry, training_curves

    return {
        "training_curves": training_curves(trained.history, title=f"Training {name}"),
        "learned_geometry": learned_geometry(
            trained.model.object,
            trained.model.learned_object(),
            seen=seen_of(trained),
            title=f"Geometry learned by {name}",
        ),
    }


def seen_of(trained: TrainedModel) -> NDArray[np.bool_] | None:
    """Which learned corners tosses have shown, (n_c,); None where it was not looked at."""
    links = trained.parameters.get("geometry")
    if not links:
        return None
    drawn, scale = trained.model.learned_object().drawn, trained.model.measurement.length_scale
    seen = np.zeros(drawn.n_corners, dtype=bool)
    for body, link in enumerate(links):
        own = np.flatnonzero(drawn.corner_body == body)
        if not len(own):
            continue
        listed = np.array(link["vertices_m"]) / scale
        apart = np.linalg.norm(drawn.corner_pos[own][:, None] - listed[None], axis=-1)
        seen[own] = np.array(link["seen"], dtype=bool)[apart.argmin(axis=1)]
    return seen


def write_figures(figures: dict[str, Figure], folder: Path) -> list[Path]:
    """Write each as NAME.png into the folder; returns the paths."""
    paths = []
    for name, figure in figures.items():
        path = folder / f"{name}.png"
        with output_file(path) as temporary:
            figure.savefig(temporary)
        paths.append(path)
    return paths
