"""Corners and centres of mass: as given, as learned, and (where it is known) as they are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.evaluation.figures.style import (
    INK,
    LOOKS,
    MUTED,
    Look,
    footnote,
    key_row,
    new_figure,
    number,
    panel_grid,
    styled,
)
from tossid.evaluation.figures.wireframe import View, view_from, wireframe
from tossid.objects import ObjectModel
from tossid.settings.figures import FigureSettings

Array = NDArray[np.float64]

_FACTORS = (1, 2, 3, 5, 10, 20, 50, 100)
_VIEWS = (
    ("from above", View(np.array([[1.0, 0, 0], [0, 1.0, 0]]), np.array([0, 0, 1.0])), "xy"),
    ("from the front", View(np.array([[1.0, 0, 0], [0, 0, 1.0]]), np.array([0, -1.0, 0])), "xz"),
    ("from the right", View(np.array([[0, 1.0, 0], [0, 0, 1.0]]), np.array([1.0, 0, 0])), "yz"),
    ("oblique", view_from(np.deg2rad(-62), np.deg2rad(24)), ""),
)
_SOURCES = {"given": LOOKS["given"], "truth": Look("truth", INK, "x", "--"), "learned": LOOKS["learned"]}


def exaggeration(
    given: ObjectModel,
    learned: ObjectModel,
    truth: ObjectModel | None = None,
    *,
    way: Sequence[Array] = (),
    settings: FigureSettings = FigureSettings(),
) -> float:
    """The round factor that makes the largest shift of a corner or a centre of mass visible, but not absurd.

    Args:
        given: The object as it was stated.
        learned: The object as it was learned.
        truth: The object as it is, if that is known.
        way: As of `learned_geometry`.
        settings: How large the largest shift may be drawn.

    Returns:
        The factor, at least 1.
    """
    shifts = [np.linalg.norm(step - given.corner_pos, axis=1).max() for step in way]
    shifts += [
        np.linalg.norm(getattr(other, part) - getattr(given, part), axis=1).max()
        for other in (learned, truth)
        if other is not None
        for part in ("corner_pos", "com")
    ]
    largest = max(shifts)
    fitting = [f for f in _FACTORS if f * largest <= settings.shift_share * given.width]
    return float(max(fitting)) if fitting and largest > 1e-9 else 1.0


UNSEEN, WAY = "#c2410c", "#9467bd"
"""Colours of what no toss has shown, and of where corners began."""


@styled
def learned_geometry(
    given: ObjectModel,
    learned: ObjectModel,
    truth: ObjectModel | None = None,
    *,
    factor: float | None = None,
    seen: NDArray[np.bool_] | None = None,
    way: Sequence[Array] = (),
    unseen: Array | None = None,
    title: str = "Learned geometry",
    settings: FigureSettings = FigureSettings(),
) -> Figure:
    """Each body in three orthographic views and an oblique one: corners and centre of mass, before and after.

    What is drawn of `learned` and `truth` is given + factor (theirs - given), so that shifts of a millimetre are seen;
    the factor and the true sizes stand in the subtitle.

    Args:
        given: The object as it was stated.
        learned: The object as it was learned.
        truth: The object as it is, if that is known.
        factor: The exaggeration; a round number that fits the shifts if None.
        seen: Which learned corners tosses have shown (of a round object, which points of its surface), (n_c,); the
            others are crossed out. None for all.
        way: Corners (n_c, 3) before training, and after each stage that moved them [m]: drawn as paths.
        unseen: Points (m, 3) in the base's frame to which the object may reach, as no toss decides it [m].
        title: The figure's title.
        settings: How large the largest shift may be drawn.

    Returns:
        The figure.

    Raises:
        InputError: The objects have different corners or bodies.
    """
    given, learned, truth = given.drawn, learned.drawn, None if truth is None else truth.drawn
    objects = {"given": given, "truth": truth, "learned": learned}
    shown = {name: model for name, model in objects.items() if model is not None}
    for name, model in shown.items():
        if model.corner_pos.shape != given.corner_pos.shape or model.com.shape != given.com.shape:
            raise InputError(f"{name} has {model.n_corners} corners on {model.n_bodies} bodies, given has others")
    scale = exaggeration(given, learned, truth, way=way, settings=settings) if factor is None else factor
    steps = np.array([given.corner_pos + scale * (step - given.corner_pos) for step in way])  # (k, n_c, 3)
    farthest = max((float(np.linalg.norm(step - given.corner_pos, axis=1).max()) for step in steps), default=0.0)

    lines = [_shift_line("learned", given, learned)]
    if truth is not None:
        lines += [_shift_line("truth", given, truth), _shift_line("from learned to truth", learned, truth)]
    beyond = np.zeros((0, 3)) if unseen is None else np.reshape(unseen, (-1, 3))
    top, row, above = 1.3 + 0.2 * (len(lines) - 1), 1.52, 0.72
    height = top + given.n_bodies * row + (given.n_bodies - 1) * above + 0.9
    figure = new_figure(title, "\n".join(lines), height=height)
    axes = panel_grid(
        figure,
        given.n_bodies,
        4,
        left=0.95 if given.n_bodies > 1 else 0.7,
        top=top,
        bottom=0.9,
        between=0.75,
        above=above,
    )
    entries = [
        (Line2D([], [], color=_SOURCES[n].color, ls=_SOURCES[n].linestyle, lw=1.7), _drawn_name(n, scale))
        for n in shown
    ]
    entries += [(Line2D([], [], color=INK, ls="none", marker="+", ms=9, mew=1.8), "centre of mass")]
    if len(steps):
        entries += [(Line2D([], [], color=WAY, lw=0.9, marker="o", mfc="white", ms=4), "start and way of a corner")]
    if seen is not None and not seen.all():
        entries += [(Line2D([], [], color=UNSEEN, ls="none", marker="x", ms=7, mew=1.6), "never on the ground")]
    if len(beyond):
        entries += [(Line2D([], [], color=UNSEEN, ls="none", marker="x", ms=4, mew=0.9), "may reach here: never seen")]
    key_row(figure, entries, y=top - 0.6)

    for b in range(given.n_bodies):
        own = given.corner_body == b
        base = given.corner_pos[own]
        edges = wireframe(base).edges
        hidden = beyond if b == 0 else beyond[:0]
        room = max(1.35 * settings.shift_share * given.width, farthest)
        middle = 0.5 * (base.min(axis=0) + base.max(axis=0))
        reach = 1e3 * max(0.5 * np.ptp(base, axis=0).max() + room, 1.1 * np.abs(hidden - middle).max(initial=0.0))
        for j, (name, view, letters) in enumerate(_VIEWS):
            ax = axes[b, j]
            for source, model in shown.items():
                corners = view(1e3 * (base + scale * (model.corner_pos[own] - base)))
                com = view(1e3 * (given.com[b] + scale * (model.com[b] - given.com[b])))
                _draw_body(ax, corners, com, edges, source)
                if source == "learned" and len(steps):
                    _draw_way(ax, view(1e3 * steps[:, own]))
                if source == "learned" and seen is not None:
                    ax.plot(*corners[~seen[own]].T, "x", ms=7, mew=1.6, color=UNSEEN, zorder=6, label="never seen")
            ax.plot(*view(1e3 * hidden).T, "x", ms=4, mew=0.9, color=UNSEEN, zorder=1, label="may reach")
            _frame(ax, view(1e3 * middle), reach * (1.0 if letters else 1.45), letters)
            if not b:
                ax.set_title(name, fontsize=9.5)
        if given.n_bodies > 1:
            axes[b, 0].annotate(
                given.body_names[b],
                (0, 0.5),
                (-58, 0),
                xycoords="axes fraction",
                textcoords="offset points",
                rotation=90,
                va="center",
                fontsize=10,
                weight="bold",
                color=MUTED,
            )
    foot = "Body frame. " + (f"Shifts are drawn {scale:g} times their size." if scale != 1 else "Shifts are to scale.")
    footnote(figure, foot)
    return figure


def _draw_body(ax: Axes, corners: Array, com: Array, edges: NDArray[np.int64], source: str) -> None:
    """A body's edges, corners and centre of mass in one view [mm]."""
    style = _SOURCES[source]
    order = {"given": 2, "learned": 3, "truth": 4}[source]
    lines = LineCollection(
        list(corners[edges]),
        colors=style.color,
        linewidths=1.2 if source == "given" else 1.5,
        linestyles=style.linestyle,
        zorder=order,
        label=source,
    )
    ax.add_collection(lines, autolim=False)
    if source == "learned":
        ax.plot(*corners.T, "o", ms=3.5, color=style.color, zorder=order, label="learned corners")
    ax.plot(*com, "+", ms=9, mew=1.8, color=style.color, zorder=order + 3, label=f"{source} com")


def _draw_way(ax: Axes, steps: Array) -> None:
    """Where corners began and how they went, (k, n, 2) in one view [mm]."""
    ax.plot(*steps[0].T, "o", ms=4, mfc="white", mec=WAY, mew=0.9, zorder=5, label="start")
    paths = LineCollection(list(steps.swapaxes(0, 1)), colors=WAY, linewidths=0.9, zorder=5, label="way")
    ax.add_collection(paths, autolim=False)


def _frame(ax: Axes, middle: Array, room: float, letters: str) -> None:
    """Equal scales around a body; no axes where the view has no directions to name."""
    ax.set_aspect("equal", adjustable="box")
    ax.set_xlim(middle[0] - room, middle[0] + room)
    ax.set_ylim(middle[1] - room, middle[1] + room)
    if not letters:
        ax.set_axis_off()
        return
    ax.set_xlabel(f"{letters[0]} [mm]", labelpad=1)
    ax.set_ylabel(f"{letters[1]} [mm]", labelpad=-2)
    ax.locator_params(nbins=5)


def _shift_line(name: str, start: ObjectModel, end: ObjectModel) -> str:
    """The sizes of the shifts, in words."""
    corners = 1e3 * np.linalg.norm(end.corner_pos - start.corner_pos, axis=1)
    com = 1e3 * np.linalg.norm(end.com - start.com, axis=1).max()
    text = f"{name}: corners moved {number(corners.mean(), 2)} mm on average, at most {number(corners.max(), 2)} mm"
    return text + (f"; centre of mass {number(com, 2)} mm" if com > 1e-6 else "; centre of mass not moved")


def _drawn_name(name: str, scale: float) -> str:
    return name if name == "given" or scale == 1 else f"{name} (shifts ×{scale:g})"
