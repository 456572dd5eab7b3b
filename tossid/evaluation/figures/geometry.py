"""Corners and centres of mass: as given, as learned, and (where it is known) as they are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
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
    sample,
    styled,
)
from tossid.evaluation.figures.wireframe import View, posed, view_from, wireframe
from tossid.objects import ObjectModel

Array = NDArray[np.float64]

SHIFT_SHARE = 0.15
"""Shifts of corners are exaggerated until the largest is about this share of the object's width."""
FARTHEST_UNSEEN = 1.3
"""How far a picture goes out to what no toss has shown, over what it shows without."""
FACTORS = (1, 2, 3, 5, 10, 20, 50, 100)
ANGLES = (-2.0, -1.0, 0.0, 1.0, 2.0)
"""Of the hinges, at which an object with joints is drawn [rad]; all joints take the same."""
UNSEEN, PATH = "#c2410c", "#9467bd"
"""Colours of what no toss has shown, and of where corners began."""
OBLIQUE = view_from(np.deg2rad(-62), np.deg2rad(24))
VIEWS = (
    ("from above", View(np.array([[1.0, 0, 0], [0, 1.0, 0]]), np.array([0, 0, 1.0])), "xy"),
    ("from the front", View(np.array([[1.0, 0, 0], [0, 0, 1.0]]), np.array([0, -1.0, 0])), "xz"),
    ("from the right", View(np.array([[0, 1.0, 0], [0, 0, 1.0]]), np.array([1.0, 0, 0])), "yz"),
    ("oblique", OBLIQUE, ""),
)
SOURCES = {"given": LOOKS["given"], "truth": Look("truth", INK, "x", "--"), "learned": LOOKS["learned"]}


def exaggeration(
    given: ObjectModel, learned: ObjectModel, truth: ObjectModel | None = None, *, stages: Sequence[Array] = ()
) -> float:
    """The round factor, at least 1, that makes the largest shift of a corner or a centre of mass visible.

    Arguments are those of `learned_geometry`.
    """
    shifts = [np.linalg.norm(step - given.corner_pos, axis=1).max() for step in stages]
    shifts += [
        np.linalg.norm(getattr(other, part) - getattr(given, part), axis=1).max()
        for other in (learned, truth)
        if other is not None
        for part in ("corner_pos", "com")
    ]
    fitting = [f for f in FACTORS if f * max(shifts) <= SHIFT_SHARE * given.width]
    return float(max(fitting)) if fitting and max(shifts) > 1e-9 else 1.0


@styled
def learned_geometry(
    given: ObjectModel,
    learned: ObjectModel,
    truth: ObjectModel | None = None,
    *,
    seen: NDArray[np.bool_] | None = None,
    stages: Sequence[Array] = (),
    unseen: Array | None = None,
    title: str = "Learned geometry",
) -> Figure:
    """Each body in three orthographic views and an oblique one: corners and centre of mass, before and after.

    What is drawn of `learned` and `truth` is given + factor (theirs - given), so that shifts of a millimetre are seen;
    the factor, a round number that fits the shifts, and the true sizes stand in the subtitle.

    Args:
        given: The object as it was stated.
        learned: The object as it was learned.
        truth: The object as it is, if that is known.
        seen: Which learned corners tosses have shown (of a round object, which points of its surface), (n_c,); the
            others are crossed out. None for all.
        stages: Corners (n_c, 3) before training, and after each stage that moved them [m]: drawn as paths.
        unseen: Points (m, 3) in the base's frame to which the object may reach, as no toss decides it [m].
        title: The figure's title.

    Raises:
        InputError: The objects have different corners or bodies.
    """
    given, learned, truth = given.drawn, learned.drawn, None if truth is None else truth.drawn
    objects = {"given": given} | ({} if truth is None else {"truth": truth}) | {"learned": learned}
    for name, model in objects.items():
        if model.corner_pos.shape != given.corner_pos.shape or model.com.shape != given.com.shape:
            raise InputError(f"{name} has {model.n_corners} corners on {model.n_bodies} bodies, given has others")
    scale = exaggeration(given, learned, truth, stages=stages)
    steps = np.array([given.corner_pos + scale * (step - given.corner_pos) for step in stages])  # (k, n_c, 3)
    known = np.ones(given.n_corners, dtype=bool) if seen is None or not seen.any() else seen
    farthest = max((float(np.linalg.norm(step - given.corner_pos, axis=1)[known].max()) for step in steps), default=0.0)
    beyond = np.zeros((0, 3)) if unseen is None else np.reshape(unseen, (-1, 3))

    lines = [_shift_line("learned", given, learned)]
    if truth is not None:
        lines += [_shift_line("truth", given, truth), _shift_line("from learned to truth", learned, truth)]
    n, several = given.n_bodies, given.n_bodies > 1
    top, row, above = 1.3 + 0.2 * (len(lines) - 1), 1.52, 0.72
    figure = new_figure(title, "\n".join(lines), height=top + n * row + (n - 1) * above + 0.9)
    axes = panel_grid(figure, n, 4, left=0.95 if several else 0.7, top=top, bottom=0.9, between=0.75, above=above)
    entries: list[tuple[Any, str]] = []
    for name in objects:
        text = name if name == "given" or scale == 1 else f"{name} (shifts ×{scale:g})"
        entries += [(sample(SOURCES[name].color, ls=SOURCES[name].linestyle, lw=1.7), text)]
    entries += [(sample(marker="+", ms=9, mew=1.8), "centre of mass")]
    if len(steps):
        entries += [(sample(PATH, ls="-", lw=0.9, marker="o", mfc="white", ms=4), "start and path")]
    if seen is not None and not seen.all():
        entries += [(sample(UNSEEN, marker="x", ms=7, mew=1.6), "never on the ground")]
    if len(beyond):
        entries += [(sample(UNSEEN, marker="x", ms=4, mew=0.9), "may reach here")]
    key_row(figure, entries, y=top - 0.6)

    outside: list[float] = []
    for b in range(n):
        own = given.corner_body == b
        base = given.corner_pos[own]
        edges = wireframe(base).edges
        hidden = beyond if b == 0 else beyond[:0]
        room = max(1.35 * SHIFT_SHARE * given.width, farthest)
        middle = 0.5 * (base.min(axis=0) + base.max(axis=0))
        reach = 0.5 * np.ptp(base, axis=0).max() + room
        away = np.abs(hidden - middle).max(axis=1, initial=0.0)
        reach = 1e3 * max(reach, 1.1 * min(away.max(initial=0.0), FARTHEST_UNSEEN * reach))
        outside += [float(each) for each in away if 1e3 * each > reach]
        for ax, (name, view, letters) in zip(axes[b], VIEWS, strict=True):
            for source, model in objects.items():
                corners = view(1e3 * (base + scale * (model.corner_pos[own] - base)))
                com = view(1e3 * (given.com[b] + scale * (model.com[b] - given.com[b])))
                _draw_body(ax, corners, com, edges, source)
            if len(steps):
                _draw_paths(ax, view(1e3 * steps[:, own]))
            if seen is not None:  # `corners` are the learned ones, which come last
                ax.plot(*corners[~seen[own]].T, "x", ms=7, mew=1.6, color=UNSEEN, zorder=6, label="never seen")
            ax.plot(*view(1e3 * hidden).T, "x", ms=4, mew=0.9, color=UNSEEN, zorder=1, label="may reach")
            _frame(ax, view(1e3 * middle), reach * (1.0 if letters else 1.45), letters)
            if not b:
                ax.set_title(name, fontsize=9.5)
        if several:
            where: dict[str, Any] = {"xycoords": "axes fraction", "textcoords": "offset points", "rotation": 90}
            form: dict[str, Any] = {"va": "center", "fontsize": 10, "weight": "bold", "color": MUTED}
            axes[b, 0].annotate(given.body_names[b], (0, 0.5), (-58, 0), **where, **form)
    drawn = f"Shifts are drawn {scale:g} times their size." if scale != 1 else "Shifts are to scale."
    if outside:
        drawn += f" It may reach {1e3 * max(outside):.0f} mm from the middle, beyond the picture."
    footnote(figure, f"Body frame. {drawn}")
    return figure


def _draw_body(ax: Axes, corners: Array, com: Array, edges: NDArray[np.int64], source: str) -> None:
    """A body's edges, corners and centre of mass in one view [mm]."""
    _, color, _, linestyle = SOURCES[source]
    order = {"given": 2, "learned": 3, "truth": 4}[source]
    form: dict[str, Any] = {"colors": color, "linestyles": linestyle, "zorder": order, "label": source}
    lines = LineCollection(list(corners[edges]), linewidths=1.2 if source == "given" else 1.5, **form)
    ax.add_collection(lines, autolim=False)
    if source == "learned":
        ax.plot(*corners.T, "o", ms=3.5, color=color, zorder=order, label="learned corners")
    ax.plot(*com, "+", ms=9, mew=1.8, color=color, zorder=order + 3, label=f"{source} com")


def _draw_paths(ax: Axes, steps: Array) -> None:
    """Where corners began and how they went, (k, n, 2) in one view [mm]."""
    ax.plot(*steps[0].T, "o", ms=4, mfc="white", mec=PATH, mew=0.9, zorder=5, label="start")
    paths = LineCollection(list(steps.swapaxes(0, 1)), colors=PATH, linewidths=0.9, zorder=5, label="path")
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


@styled
def geometry_at_angles(
    truth: ObjectModel,
    learned: ObjectModel,
    *,
    seen: NDArray[np.bool_],
    truth_name: str = "true",
    title: str = "Learned geometry",
) -> Figure:
    """The object at each joint angle: true edges, learned edges, and which corners ever touched the ground.

    Args:
        truth: The true object, or the stated one.
        learned: The same object with learned corners.
        seen: Corners (n_c,) that carried load in the training tosses; the places of the others are not known.
        truth_name: What the first object is called ("true", "as published").
        title: The figure's title.

    Raises:
        InputError: The objects have different corners, or no joints.
    """
    if truth.corner_pos.shape != learned.corner_pos.shape or seen.shape != (truth.n_corners,) or not truth.n_joints:
        raise InputError("geometry at joint angles needs two objects with the same corners, and joints")
    subtitle = f"{int(seen.sum())} of {len(seen)} corners touched the ground"
    if seen.any():
        off = 1e3 * np.linalg.norm(learned.corner_pos - truth.corner_pos, axis=1)[seen]
        subtitle += f": at most {number(off.max(), 2)} mm from {truth_name}, {number(off.mean(), 2)} mm on average"
    figure = new_figure(title, subtitle, height=3.4)
    axes = panel_grid(figure, 1, len(ANGLES), left=0.15, right=0.15, top=1.3, bottom=0.75, between=0.1)[0]
    color, middles, reach = LOOKS["learned"].color, [], 0.0
    for ax, angle in zip(axes, ANGLES, strict=True):
        q = np.r_[np.zeros(3), 1.0, np.zeros(3), np.full(truth.n_joints, angle)]
        points = []
        for name, model, shade, width in ((truth_name, truth, INK, 1.0), ("learned", learned, color, 1.6)):
            for b, (corners, _) in enumerate(posed(model, q)):
                own = model.corner_body == b
                edges = wireframe(truth.corner_pos[own]).edges
                flat = 1e3 * OBLIQUE(corners)
                points.append(flat)
                ax.add_collection(LineCollection(list(flat[edges]), colors=shade, linewidths=width, label=name))
                if model is learned:
                    ax.plot(*flat[seen[own]].T, "o", ms=3.5, color=color, label="touched")
                    ax.plot(*flat[~seen[own]].T, "o", ms=3.5, mfc="white", color=color, label="unseen")
        low, high = np.concatenate(points).min(axis=0), np.concatenate(points).max(axis=0)
        middles.append(0.5 * (low + high))
        reach = max(reach, 0.55 * float((high - low).max()))
        ax.set_title(f"{np.rad2deg(angle):.0f}°", fontsize=9.5)
    for ax, middle in zip(axes, middles, strict=True):
        _frame(ax, middle, reach, "")
    entries = [
        (sample(lw=1.2), truth_name),
        (sample(color, lw=1.8), "learned"),
        (sample(color, marker="o", ms=4), "touched the ground"),
        (sample(color, marker="o", mfc="white", ms=4), "never did: not known"),
    ]
    key_row(figure, entries, y=0.72)
    footnote(figure, "Joint angle above each. To scale.")
    return figure
