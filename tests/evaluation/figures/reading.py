"""Reading a drawn figure back: its lines, bars and texts, and whether texts touch."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.transforms import Bbox


def panels(figure: Figure) -> list[Axes]:
    """Axes with axes to read (a film strip's windows have none)."""
    return [ax for ax in figure.axes if ax.axison]


def titled(figure: Figure, title: str) -> Axes:
    (ax,) = [ax for ax in figure.axes if ax.get_title(loc="left").startswith(title)]
    return ax


def lines(ax: Axes, label: str) -> list[Line2D]:
    return [line for line in ax.lines if line.get_label() == label]


def line(ax: Axes, label: str) -> Line2D:
    (one,) = lines(ax, label)
    return one


def words(figure: Figure) -> str:
    return "\n".join(text.get_text() for text in figure.findobj(Text))


def described(figure: Figure) -> str:
    """What is drawn, panel by panel, a line for each axis, line, patch, collection and text, to four digits."""
    found = [text.get_text() for text in figure.texts]
    for number, ax in enumerate(figure.axes):
        limits = f"x {_digits(ax.get_xlim())}, y {_digits(ax.get_ylim())}"
        found += [
            f"== {number}: {ax.get_title(loc='left') or ax.get_title()}",
            f"{ax.get_xscale()} {ax.get_yscale()} {limits}",
        ]
        found += [f"axes: {ax.get_xlabel()}; {ax.get_ylabel()}"] if ax.axison else []
        drawn = [line for line in ax.lines if line.get_label() != "_leader"]  # which lead to where a label has room
        found += [f"line {x.get_label()}: x {_digits(x.get_xdata())}; y {_digits(x.get_ydata())}" for x in drawn]
        for each in ax.patches:
            corners = each.get_patch_transform().transform(each.get_path().vertices)
            found.append(f"patch {each.get_label()} {each.get_hatch()}: {_digits(corners)}")
        for each in ax.collections:
            paths = [path.vertices for path in each.get_paths()]
            corners, places = np.vstack([np.zeros((0, 2)), *paths]), each.get_offsets()
            values = [] if each.get_array() is None else each.get_array()
            found.append(f"collection {each.get_label()}: {len(paths)} paths {_digits(corners)} at {_digits(places)}")
            found[-1] += f" of {_digits(values)}" if len(values) else ""
        found += [f"text: {text.get_text()}" for text in ax.texts]
    return "\n".join(line.rstrip() for line in found) + "\n"


def _digits(x: object) -> str:
    """Few numbers to four digits, of many their count, ends, least, largest, mean and mean step."""
    numbers = np.ma.filled(np.ma.asarray(x, dtype=float), np.nan).ravel()
    n, finite = len(numbers), numbers[np.isfinite(numbers)]
    if n > 16:
        step = np.abs(np.diff(finite)).mean()
        numbers = np.array([*numbers[[0, -1]], finite.min(), finite.max(), finite.mean(), step])
    exact = np.round(numbers, 9) + 0.0  # no rounding of zero, and no sign of it
    return (f"{n}: " if n > 16 else "") + " ".join(f"{each:.4g}" for each in exact)


def boxes(figure: Figure) -> Iterator[tuple[str, Bbox]]:
    """Every text that is drawn, with its box [px]."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    hidden = {
        id(text) for ax in figure.axes if not ax.axison for text in ax.xaxis.findobj(Text) + ax.yaxis.findobj(Text)
    }
    for ax in figure.axes:
        for axis, (low, high) in ((ax.xaxis, ax.get_xlim()), (ax.yaxis, ax.get_ylim())):
            for tick in axis.get_major_ticks() + axis.get_minor_ticks():
                inside = low - 1e-9 <= tick.get_loc() <= high + 1e-9
                if not inside or not tick.label1.get_visible():
                    hidden.add(id(tick.label1))
                hidden.add(id(tick.label2))
    for text in figure.findobj(Text):
        if text.get_visible() and text.get_text().strip() and id(text) not in hidden:
            yield text.get_text(), Text.get_window_extent(text, renderer)  # an annotation's own would hold its arrow


def assert_legible(figure: Figure) -> None:
    """No text touches another or leaves the figure; every axis is labelled with its unit."""
    found = list(boxes(figure))
    assert len(found) > 5
    touching = [
        (a, b)
        for i, (a, box_a) in enumerate(found)
        for b, box_b in found[:i]
        if Bbox.intersection(*_shrunk(box_a, box_b))
    ]
    assert not touching, touching
    width, height = figure.canvas.get_width_height()
    outside = [text for text, box in found if box.x0 < 0 or box.y0 < 0 or box.x1 > width or box.y1 > height]
    assert not outside, outside
    for ax in panels(figure):
        for axis in (ax.xaxis, ax.yaxis):
            shows_ticks = any(label.get_visible() and label.get_text() for label in axis.get_ticklabels())
            label = axis.get_label_text()
            assert "[" in label or not shows_ticks, (ax.get_title(loc="left"), label)


def _shrunk(*pair: Bbox) -> tuple[Bbox, ...]:
    """A text's box has a rim of air."""
    return tuple(Bbox.from_extents(b.x0 + 1, b.y0 + 1, b.x1 - 1, b.y1 - 1) for b in pair)
