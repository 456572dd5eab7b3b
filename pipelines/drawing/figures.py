"""Figures as files, and which a training has."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tossid.outputs import output_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from tossid.models import TrainedModel
    from tossid.types import Toss


def training_figures(trained: TrainedModel, *, name: str) -> dict[str, Figure]:
    """Curves over epochs, and the geometry before and after."""
    from tossid.evaluation.figures import learned_geometry, training_curves

    return {
        "training_curves": training_curves(trained.history, title=f"Training {name}"),
        "learned_geometry": learned_geometry(
            trained.model.object,
            trained.model.learned_object(),
            seen=seen_of(trained),
            stages=stages_of(trained),
            unseen=np.array(trained.parameters.get("from_nothing", {}).get("unseen_m", [])),
            title=f"Geometry learned by {name}",
        ),
    }


def write_hull_film(trained: TrainedModel, tosses: Sequence[Toss], path: Path) -> Path:
    """Write how the hull of an unknown object took shape over tosses; returns the path."""
    from tossid.evaluation.figures import hull_film, save_film

    with output_file(path) as temporary:
        save_film(hull_film(tosses, trained.object), temporary, frame_ms=400)
    return path


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


def stages_of(trained: TrainedModel) -> list[NDArray[np.float64]]:
    """Corners before training and after each stage that moved them, (n_c, 3) each [m]; empty where none did."""
    links, learned = trained.parameters.get("geometry") or [], trained.model.learned_object()
    count = max((len(link.get("way_m", ())) for link in links), default=0)
    steps = [np.zeros((learned.n_corners, 3)) for _ in range(count)]
    for body, link in enumerate(links):
        for step, corners in zip(steps, link["way_m"], strict=bool(count)):
            step[learned.corner_body == body] = np.array(corners) / trained.model.measurement.length_scale
    return steps


def write_figures(figures: dict[str, Figure], folder: Path) -> list[Path]:
    """Write each as NAME.png into the folder; returns the paths."""
    paths = []
    for name, figure in figures.items():
        path = folder / f"{name}.png"
        with output_file(path) as temporary:
            figure.savefig(temporary)
        paths.append(path)
    return paths
