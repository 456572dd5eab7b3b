"""The one look of all figures: fonts, colours, panels, labels. Object-oriented matplotlib; nothing global changes.

Colours are of Okabe and Ito's palette, which colour-blind readers can distinguish, and every model has a marker of its
own.
"""

from __future__ import annotations

import functools
import io
import textwrap
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, ParamSpec

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.text import Text
from matplotlib.ticker import LogFormatter
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

Array = NDArray[np.float64]
P = ParamSpec("P")

DPI = 150
WIDTH = 9.0
"""Width of nearly every figure [in]: 1350 pixels, readable where a browser halves them."""
INK, MUTED, GRID, RULE = "#26282c", "#70757d", "#e3e5e8", "#9aa0a8"
SMALL, NAME_SIZE = 8.5, 9.0
"""Size of the smallest text, and of names at the ends of lines [pt]."""

_STYLE: dict[str, Any] = {
    "figure.dpi": DPI,
    "figure.facecolor": "white",
    "savefig.dpi": "figure",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.5,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.labelsize": 9.5,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 7,
    "axes.edgecolor": RULE,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "xtick.color": RULE,
    "ytick.color": RULE,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 9,
    "ytick.labelsize": 9,
    "lines.linewidth": 1.7,
    "lines.markersize": 5,
    "lines.solid_capstyle": "round",
    "hatch.linewidth": 0.5,
    "text.parse_math": False,  # a toss may be named "a$\\x$"
    "legend.frameon": False,
    "legend.fontsize": 9,
}


class Look(NamedTuple):
    """How a model or a source is drawn in every figure: its name in legends, and how its lines look."""

    label: str
    color: str
    marker: str = "o"
    linestyle: str = "-"


LOOKS = {
    "cn": Look("CN", "#D55E00", "o"),
    "cnrp": Look("CNRP", "#0072B2", "s"),
    "cnrpi": Look("CNRPI", "#009E73", "D"),
    "e2e": Look("E2E", "#CC79A7", "^"),
    "diffsim": Look("DiffSim", "#C28E00", "v"),
    "measured": Look("measured", INK, "."),
    "truth": Look("truth", MUTED, "x", "--"),
    "given": Look("given", "#8b9098", "."),
    "learned": Look("learned", "#0072B2", "o"),
}
SPARE = (("#56B4E9", "P"), ("#7B4B94", "X"), ("#8C6D1F", "h"), ("#444444", "*"))
"""Colours and markers of what has no look of its own."""


def look(name: str, *, others: Sequence[str] = ()) -> Look:
    """The look of a model or a source.

    Args:
        name: Its name.
        others: All names in the figure; unknown ones get spare colours in this order.
    """
    if name in LOOKS:
        return LOOKS[name]
    unknown = [other for other in dict.fromkeys([*others, name]) if other not in LOOKS]
    return Look(name, *SPARE[unknown.index(name) % len(SPARE)])


def styled(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """A decorator: the function draws in the common style, whatever a user's matplotlibrc says, and changes nothing."""

    @functools.wraps(draw)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with matplotlib.style.context(["default", _STYLE]):
            figure = draw(*args, **kwargs)
        for axis in (axis for ax in figure.axes for axis in (ax.xaxis, ax.yaxis)):
            if isinstance(axis.get_major_formatter(), LogFormatter):  # spells powers as mathematics
                for text in (*axis.get_ticklabels(), *axis.get_ticklabels(minor=True)):
                    text.set_parse_math(True)
        return figure

    return wrapped


def as_png(figure: Figure) -> bytes:
    """A figure as a PNG at `DPI`, as reports embed and save it."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def new_figure(title: str, subtitle: str = "", *, height: float, width: float = WIDTH) -> Figure:
    """An empty figure of a height and width [in] with its title, and lines below the title."""
    figure = Figure(figsize=(width, height), dpi=DPI)
    figure.text(0.15 / width, 1 - 0.14 / height, title, va="top", fontsize=12.5, fontweight="bold")
    if subtitle:
        figure.text(0.15 / width, 1 - 0.42 / height, subtitle, va="top", fontsize=9.5, color=MUTED, linespacing=1.35)
    return figure


def wrapped(text: str, width: float = WIDTH) -> str:
    """A text in lines that fit into a figure of a width [in], at the smallest size of text."""
    across = int((width - 0.3) * 72 / (0.58 * SMALL))  # a letter is 0.58 as wide as its size, and most are less
    return "\n".join(textwrap.fill(line, across) for line in text.splitlines())


def footnote(figure: Figure, text: str) -> Text:
    """Lines at the foot of a figure that explain its bars, bands and dots."""
    w, h = figure.get_size_inches()
    text = wrapped(text, w)
    return figure.text(0.15 / w, 0.10 / h, text, va="bottom", fontsize=SMALL, color=MUTED, linespacing=1.3)


def panel_grid(
    figure: Figure,
    rows: int,
    columns: int,
    *,
    left: float = 0.75,
    right: float = 0.25,
    top: float = 0.95,
    bottom: float = 0.75,
    between: float = 0.75,
    above: float = 0.65,
    heights: Sequence[float] | None = None,
) -> NDArray[Any]:
    """Axes (rows, columns) within margins, with gaps `between` columns and `above` rows, all in inches.

    Args:
        figure: The figure.
        rows: How many rows.
        columns: How many columns.
        left: Left margin [in].
        right: Right margin [in].
        top: Upper margin [in].
        bottom: Lower margin [in].
        between: Gap between columns [in].
        above: Gap between rows [in].
        heights: Relative heights of the rows; equal if None.
    """
    w, h = figure.get_size_inches()
    share = np.ones(rows) if heights is None else np.asarray(heights, dtype=float)
    tall = share / share.sum() * (h - top - bottom - above * (rows - 1))
    wide = (w - left - right - between * (columns - 1)) / columns
    axes = np.empty((rows, columns), dtype=object)
    for i, j in np.ndindex(axes.shape):
        x, y = left + j * (wide + between), h - top - tall[: i + 1].sum() - above * i
        axes[i, j] = figure.add_axes((x / w, y / h, wide / w, tall[i] / h))
    return axes


def axes_inches(ax: Axes) -> tuple[float, float]:
    """Width and height of axes [in]."""
    figure = ax.get_figure(root=True)
    assert figure is not None
    width, height = ax.get_position().size * figure.get_size_inches()
    return float(width), float(height)


def spread(wanted: Sequence[float], gap: float, low: float = -np.inf, high: float = np.inf) -> Array:
    """Positions nearest to the wanted ones (least squares) that are at least a gap apart, in the same order.

    They come from an isotonic regression, and are then kept between `low` and `high`.
    """
    order = np.argsort(wanted, kind="stable")
    target = np.asarray(wanted, dtype=float)[order] - gap * np.arange(len(order))
    place = isotonic_regression(target).x if len(target) else target
    place = np.maximum(np.minimum(place, high - gap * (len(order) - 1)), low) + gap * np.arange(len(order))
    out = np.empty(len(order))
    out[order] = place
    return out


def halo(text: Text) -> Text:
    """The text, with a white rim that makes it readable over lines."""
    text.set_path_effects([withStroke(linewidth=2.5, foreground="white")])
    return text


def label_ends(ax: Axes, ends: Iterable[tuple[float, float, str, str]]) -> list[Text]:
    """Names at the right end of lines, moved apart where they would touch, with thin leaders.

    Args:
        ax: The axes, with limits and scales already set.
        ends: x, y (data units), text and colour at each line's end; those whose y is not finite are left out.
    """
    kept = [end for end in ends if np.isfinite(end[1])]
    if not kept:
        return []
    width, height = axes_inches(ax)
    to_axes = ax.transData + ax.transAxes.inverted()
    at = np.array([to_axes.transform((x, y)) for x, y, _, _ in kept])
    at[:, 1] = np.clip(at[:, 1], 0, 1)
    place = spread(list(at[:, 1]), 1.35 * NAME_SIZE / 72 / height, 0.0, 1.0)
    leader: dict[str, Any] = {"lw": 0.7, "alpha": 0.6, "clip_on": False, "zorder": 1, "label": "_leader"}
    texts = []
    for (x, y), to, (_, _, text, color) in zip(at, place, kept, strict=True):
        bends = [x, 1 + 0.04 / width, 1 + 0.14 / width]
        ax.plot(bends, [y, y, to], color=color, transform=ax.transAxes, **leader)
        weight = "normal" if color == MUTED else "bold"
        form: dict[str, Any] = {"color": color, "fontsize": NAME_SIZE, "va": "center", "weight": weight}
        texts.append(ax.text(1 + 0.18 / width, to, text, transform=ax.transAxes, **form))
    return texts


def sample(color: str = INK, **form: Any) -> Line2D:
    """A handle for `key_row`: a line, or with `marker` a marker alone.

    Args:
        color: Its colour.
        **form: As of `Line2D`.
    """
    return Line2D([], [], color=color, **({"ls": "none"} if "marker" in form else {}) | form)


def key_row(figure: Figure, entries: Sequence[tuple[Any, str]], *, y: float, x: float = 0.15) -> None:
    """Draw a legend in one row: handles with their texts, `y` inches below the top and `x` from the left."""
    w, h = figure.get_size_inches()
    legend = figure.legend(
        [handle for handle, _ in entries],
        [text for _, text in entries],
        loc="upper left",
        bbox_to_anchor=(x / w, 1 - y / h),
        ncols=len(entries),
        borderpad=0,
        borderaxespad=0,
        columnspacing=1.6,
        handlelength=1.6,
        handletextpad=0.6,
    )
    legend.set_in_layout(False)


def number(value: float, digits: int = 3) -> str:
    """A number with so many significant digits, without an exponent for everyday sizes; "none" if it is not finite."""
    if not np.isfinite(value):
        return "none"
    if value == 0 or 1e-3 <= abs(value) < 1e5:
        decimals = max(0, digits - 1 - int(np.floor(np.log10(abs(value))))) if value else 0
        return f"{value:.{decimals}f}".replace("-", "−")
    return f"{value:.{digits - 1}e}".replace("-", "−")
