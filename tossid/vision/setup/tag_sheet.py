"""A sheet of tags to print, at true scale, with what is needed to put each where the layout says it is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tossid.errors import ObjectError
from tossid.objects import ObjectModel, Tag
from tossid.vision.setup.faces import TAG_CELLS, tag_bitmap

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAPERS = {"a4": (210.0, 297.0), "letter": (215.9, 279.4)}
"""Width and height [mm]."""
QUIET = (TAG_CELLS + 2) / TAG_CELLS
"""Edge of the white margin that a detector needs, over that of the black border."""
_MARGIN, _HEAD, _CAPTION, _GAP = 12.0, 30.0, 8.0, 8.0
"""Distances on a page [mm]."""
_INCH = 25.4
"""[mm]."""
_GREY = "0.6"


def tag_sheets(model: ObjectModel, *, paper: str = "a4") -> list[Figure]:
    """The object's tags as pages to print at 100 %.

    Each tag stands in its white margin, to be cut along the thin line, with ticks at the middle of its sides and a
    line that says where it belongs. A ruler of 100 mm checks the printer.

    Args:
        model: The object with its tags.
        paper: One of `PAPERS`.

    Returns:
        The pages.

    Raises:
        ObjectError: a tag is larger than the paper.
    """
    width, height = PAPERS[paper]
    pages: list[Figure] = []
    ax, x, y, row = _page(model.name, paper, pages), _MARGIN, _HEAD, 0.0
    for tag in sorted(model.tags, key=lambda tag: -tag.size):
        side = 1e3 * tag.size * QUIET
        if x > _MARGIN and x + side > width - _MARGIN:
            x, y, row = _MARGIN, y + row + _GAP, 0.0
        if y > _HEAD and y + side + _CAPTION > height - _MARGIN:
            ax, x, y, row = _page(model.name, paper, pages), _MARGIN, _HEAD, 0.0
        if x + side > width - _MARGIN or y + side + _CAPTION > height - _MARGIN:
            raise ObjectError(f"tag {tag.id} of {1e3 * tag.size:.0f} mm does not fit on {paper} paper")
        _draw(ax, tag, model, x, y)
        x, row = x + side + _GAP, max(row, side + _CAPTION)
    return pages


def _page(name: str, paper: str, pages: list[Figure]) -> Axes:
    """An empty page; its axes are in millimetres from its upper left corner."""
    from matplotlib.figure import Figure

    width, height = PAPERS[paper]
    figure = Figure(figsize=(width / _INCH, height / _INCH), facecolor="white")
    ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    ax.set_xlim(0, width)
    ax.set_ylim(height, 0)
    ax.axis("off")
    pages.append(figure)
    text = f"{name}: AprilTags 36h11. Print at 100 % (no fitting to the page); this line is 100 mm long:"
    ax.text(_MARGIN, 12.0, text, fontsize=9, va="center")
    ax.plot([_MARGIN, _MARGIN + 100.0], [18.0, 18.0], color="black", linewidth=0.6, solid_capstyle="butt")
    for end in (_MARGIN, _MARGIN + 50.0, _MARGIN + 100.0):
        ax.plot([end, end], [16.5, 19.5], color="black", linewidth=0.6)
    ax.text(width - _MARGIN, 18.0, f"page {len(pages)}", fontsize=9, ha="right", va="center")
    return ax


def _draw(ax: Axes, tag: Tag, model: ObjectModel, x: float, y: float) -> None:
    """One tag with its margin, whose upper left corner is at x, y [mm]."""
    from matplotlib.patches import Rectangle

    cell = 1e3 * tag.size / TAG_CELLS
    side = cell * (TAG_CELLS + 2)
    ax.add_patch(Rectangle((x, y), side, side, facecolor="white", edgecolor=_GREY, linewidth=0.3))
    ax.add_patch(Rectangle((x + cell, y + cell), 8 * cell, 8 * cell, facecolor="black", linewidth=0))
    white = tag_bitmap(tag.id).astype(bool)
    for rows, columns in ((1, 1), (1, 2), (2, 1), (2, 2)):  # overlapping, so that no seam is left between cells
        for i, j in np.argwhere(_all_of(white, rows, columns)):
            corner = (x + (j + 1) * cell, y + (i + 1) * cell)
            ax.add_patch(Rectangle(corner, columns * cell, rows * cell, facecolor="white", linewidth=0))
    middle, tick = side / 2, 0.3 * cell
    for a, b in (((middle, 0), (middle, tick)), ((middle, side), (middle, side - tick))):
        ax.plot([x + a[0], x + b[0]], [y + a[1], y + b[1]], color=_GREY, linewidth=0.3)
        ax.plot([x + a[1], x + b[1]], [y + a[0], y + b[0]], color=_GREY, linewidth=0.3)
    caption = f"tag {tag.id}, {1e3 * tag.size:.1f} mm: {model.body_names[tag.body]} {_side(tag.T_body_tag[:3, 2])},"
    ax.text(x, y + side + 1.0, f"{caption} up is {_side(tag.T_body_tag[:3, 1])}", fontsize=7, va="top")


def _all_of(white: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Where a block of so many cells begins that are all white."""
    windows = np.lib.stride_tricks.sliding_window_view(white, (rows, columns))
    return np.asarray(windows.all(axis=(2, 3)))


def _side(direction: Sequence[float] | np.ndarray) -> str:
    """The axis that a direction points along ("+x"), else its components."""
    values = np.asarray(direction)
    axis = int(np.argmax(np.abs(values)))
    if abs(values[axis]) > 1 - 1e-6:
        return f"{'+' if values[axis] > 0 else '-'}{'xyz'[axis]}"
    return "(" + " ".join(f"{value:.2f}" for value in values) + ")"
