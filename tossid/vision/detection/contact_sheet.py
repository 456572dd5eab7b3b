"""A contact sheet: what the cameras saw at some moments, the tags found, and where tracking puts the object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.types import Detection

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Window = tuple[float, float, float, float]
"""First column and row of a part of an image, its width and its height [px]."""

FOUND, PLACED, EMPTY = "#1ea032", "#ff8200", "#d7d7d7"
"""Colours of tags found, of the object placed, and where there is no image."""
WIDTH, ASPECT, DPI = 3.0, 0.8, 100
"""Width of a picture [inch], its height over that, and dots an inch."""


@dataclass(frozen=True, eq=False)
class Cell:
    """One picture of the sheet.

    Attributes:
        camera: Name of the camera.
        t: Time of the frame [s].
        image: (height, width) grey; None where the camera has no frame then.
        found: Tags detected in it.
        placed: Polygons (k, 2) [px] of the object's faces that look at the camera, where tracking puts them.
        rms: Root mean square distance of the detected corners from where tracking puts them [px]; None without a pose.
    """

    camera: str
    t: float
    image: NDArray[np.uint8] | None
    found: tuple[Detection, ...] = ()
    placed: tuple[Array, ...] = ()
    rms: float | None = None


@dataclass(frozen=True, eq=False)
class Column:
    """One moment.

    Attributes:
        t: Its time [s].
        note: What happens then.
        cells: One a camera.
    """

    t: float
    note: str
    cells: tuple[Cell, ...] = field(default=())


def contact_sheet(columns: Sequence[Column], *, title: str) -> Figure:
    """Draw moments side by side, cameras one below another.

    Each picture shows the neighbourhood of the object, the small one in its corner the whole frame.

    Args:
        columns: The moments.
        title: Stands above.

    Raises:
        InputError: nothing to draw.
    """
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    if not columns or not columns[0].cells:
        raise InputError("no frames to draw a contact sheet of")
    n_rows, n_columns = len(columns[0].cells), len(columns)
    width, height = max((WIDTH + 0.1) * n_columns + 0.1, 7.6), (ASPECT * WIDTH + 0.4) * n_rows + 1.0
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white")
    grid: dict[str, Any] = {
        "left": 0.1 / width,
        "right": 1 - 0.1 / width,
        "top": 1 - 0.66 / height,
        "bottom": 0.6 / height,
    }
    axes = figure.subplots(n_rows, n_columns, squeeze=False, gridspec_kw={**grid, "wspace": 0.03, "hspace": 0.16})
    figure.text(0.1 / width, 1 - 0.28 / height, title, fontsize=11)
    for column, below in zip(columns, axes.T, strict=True):
        below[0].set_title(f"{column.t:.3f} s   {column.note}", fontsize=9, loc="left")
        for cell, ax in zip(column.cells, below, strict=True):
            ax.set(xticks=[], yticks=[], facecolor=EMPTY)
            ax.set_xlabel(caption(cell), fontsize=8, loc="left")
            if cell.image is not None:
                _draw(ax, cell, cell.image)
    words = ((FOUND, "found tag, its id"), (PLACED, "object where tracking puts it; in the corner: the whole frame"))
    handles = [Patch(edgecolor=colour, fill=False, linewidth=1.5, label=text) for colour, text in words]
    figure.legend(handles=handles, loc="lower left", ncols=2, fontsize=8, frameon=False)
    return figure


def caption(cell: Cell) -> str:
    """What stands below a picture."""
    if cell.image is None:
        return f"{cell.camera}: no frame"
    tags = ", ".join(str(d.tag_id) for d in sorted(cell.found, key=lambda d: d.tag_id))
    seen = f"tag{'s' * (len(cell.found) > 1)} {tags}" if cell.found else "no tag found"
    if cell.rms is not None:
        return f"{cell.camera}: {seen}; off by {cell.rms:.2f} px"
    return f"{cell.camera}: {seen}" + ("" if cell.placed or not cell.found else "; no pose")


def _draw(ax: Axes, cell: Cell, image: NDArray[np.uint8]) -> None:
    """The neighbourhood of the object, what was found there, and the whole frame in the upper right corner."""
    from matplotlib.patches import Polygon, Rectangle

    x, y, width, height = _window(cell, image)
    ax.imshow(image, cmap="gray", vmin=0, vmax=255, interpolation="antialiased", aspect="auto")
    ax.set(xlim=(x, x + width), ylim=(y + height, y))
    for polygon in cell.placed:
        if np.isfinite(polygon).all():
            ax.add_patch(Polygon(polygon, fill=False, edgecolor=PLACED, linewidth=0.8))
    for d in cell.found:
        ax.add_patch(Polygon(d.corners, fill=False, edgecolor=FOUND, linewidth=1.5))
        side = np.linalg.norm(d.corners - np.roll(d.corners, 1, axis=0), axis=1).min() * WIDTH * DPI / width
        if side >= 22:  # a smaller tag would be hidden
            x_id, y_id = d.corners.mean(axis=0).tolist()
            patch = {"facecolor": FOUND, "edgecolor": "none", "pad": 1.0}
            style: dict[str, Any] = {"fontsize": 8 if side > 40 else 6, "color": "white", "clip_on": True}
            ax.text(x_id, y_id, str(d.tag_id), ha="center", va="center", bbox=patch, **style)
    share = 0.24 * image.shape[0] / image.shape[1] / ASPECT
    inset = ax.inset_axes((0.76, 1 - share, 0.24, share), xticks=[], yticks=[])
    inset.imshow(image, cmap="gray", vmin=0, vmax=255, aspect="auto")
    inset.add_patch(Rectangle((x, y), width, height, fill=False, edgecolor=PLACED, linewidth=0.8))


def _window(cell: Cell, image: NDArray[np.uint8]) -> Window:
    """The part of an image that is shown: around all marks, or the whole image where there is none."""
    rows, columns = image.shape
    points = np.concatenate([d.corners for d in cell.found] + list(cell.placed) + [np.zeros((0, 2))])
    points = points[np.isfinite(points).all(axis=1)]
    most = max(columns, rows / ASPECT)
    if len(points):
        low, high = points.min(axis=0), points.max(axis=0)
        width = float(np.clip(1.6 * np.max((high - low) / [1.0, ASPECT]), 50.0, most))
        x, y = (0.5 * (low + high)).tolist()
    else:
        width, x, y = most, 0.5 * columns, 0.5 * rows
    return x - 0.5 * width, y - 0.5 * ASPECT * width, width, ASPECT * width
