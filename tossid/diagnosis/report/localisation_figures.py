"""Figures among the report's details: the residual wrench over the state, and the gap by corner of the object."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch as Swatch
from numpy.typing import NDArray

from tossid.diagnosis.findings import Corner, Interval, Relation
from tossid.diagnosis.report.figures import AFTER, BEFORE, beside, plain, with_what
from tossid.diagnosis.report.registry import report_figure
from tossid.diagnosis.report.units import percent_span, place_of, short, span
from tossid.diagnosis.report.words import state_words, wrench_words
from tossid.diagnosis.result import Diagnosis
from tossid.evaluation.figures.style import INK, MUTED, SMALL, footnote, key_row, new_figure, panel_grid, styled
from tossid.evaluation.figures.wireframe import view_from, wireframe

Array = NDArray[np.float64]

COLORS = {"flight": "#56B4E9", "contact": "#C28E00"}
WRENCH = "Residual force or torque, and the state that it depends on"
CORNERS = "The gap by corner of the object"
LETTERS = 12
"""Corners that get a letter; of more, those with the largest shares of the gap."""
AZIMUTH, ELEVATION = np.deg2rad(-68.0), np.deg2rad(22.0)
"""Direction from which the object is seen."""
DRAWN = (2.0, 98.0)
"""Percentiles of the residual wrenches between which they are drawn."""


@report_figure(
    "gap_wrench",
    alt="The residual force or torque over the state that explains it best, in flight and in contact.",
    detail=WRENCH,
    note="The residual force and torque are those, constant over a window, that best remove the window's residuals "
    "(least squares; the window's first state is uncertain). The figure draws the pair of component and state of "
    "which the state explains most on tosses that were not used for the fit. It is significant if at most one in a "
    "hundred random choices of a sign for each toss gives an equally good best pair. The path is the direction of the "
    "horizontal velocity.",
    applies=lambda diagnosis: bool(diagnosis.place.wrench or diagnosis.place.wrench_left),
)
@styled
def wrench_over_state(diagnosis: Diagnosis) -> Figure:
    """The component of the residual wrench that a state explains best, over that state; in flight and in contact.

    Args:
        diagnosis: What was found.
    """
    place = diagnosis.place
    columns = [("before", place.wrench)]
    if diagnosis.found:
        columns.append((with_what(diagnosis), place.wrench_left))
    phases = [phase for phase in COLORS if any(r.phase == phase for _, found in columns for r in found)]
    figure = new_figure(
        "The residual force or torque",
        "What would remove a window's residuals, over the state that explains most of it on held-out tosses.\n"
        "Dots: windows, with standard errors. Line: the fitted dependence.",
        height=1.75 + 2.95 * len(phases),
    )
    axes = panel_grid(figure, len(phases), len(columns), left=0.85, top=1.65, bottom=1.0, between=1.0, above=1.3)
    for i, phase in enumerate(phases):
        for j, (when, found) in enumerate(columns):
            relation = next((r for r in found if r.phase == phase), None)
            _relation(axes[i, j], f"In {phase}, {when}", relation, COLORS[phase])
    footnote(figure, "Bands: 95 % intervals over tosses. Explained: share of the squares, on held-out tosses.")
    return figure


def _relation(ax: Axes, title: str, relation: Relation | None, color: str) -> None:
    ax.annotate(
        title, (0, 1), (0, 34), xycoords="axes fraction", textcoords="offset points", weight="bold", fontsize=10
    )
    if relation is None:
        ax.axis("off")
        ax.text(0.5, 0.5, "too few windows to estimate a force", ha="center", va="center", color=MUTED)
        return
    factor, unit = _unit(relation)
    x, y, error, _ = relation.points.T
    y, error = factor * y, factor * error
    drawn = error < 4 * np.median(error)
    solid = np.clip(np.median(error) / np.maximum(error, 1e-12), 0.15, 0.8)
    for k in np.flatnonzero(drawn):
        ax.plot([x[k], x[k]], [y[k] - error[k], y[k] + error[k]], color=color, lw=0.8, alpha=0.6 * solid[k])
    ax.scatter(x[drawn], y[drawn], s=14, color=color, alpha=solid[drawn], linewidths=0)
    grid, fitted, low, high = relation.curve.T
    if relation.state_clear:
        ax.fill_between(grid, factor * low, factor * high, color=INK, alpha=0.12, lw=0)
        ax.plot(grid, factor * fitted, color=INK, lw=1.6)
    elif relation.clear:
        mean = relation.means[relation.component]
        ax.axhspan(factor * mean.low, factor * mean.high, color=INK, alpha=0.12, lw=0)
        ax.axhline(factor * mean.value, color=INK, lw=1.6)
    ax.axhline(0, color=MUTED, lw=0.8, ls="--")
    low_y, high_y = np.percentile(y[drawn], DRAWN)
    low_y, high_y = min(low_y, 0.0), max(high_y, 0.0)
    room = 0.12 * max(high_y - low_y, 1e-9)
    ax.set_ylim(low_y - room, high_y + room)
    ax.yaxis.set_major_formatter(plain)
    name, of = state_words(relation.state)
    ax.set_xlabel(f"{name} [{of}]")
    ax.set_ylabel(f"{wrench_words(relation.component)} [{unit}]")
    ax.annotate(
        _summary(relation, factor, unit),
        (0, 1),
        (0, 6),
        xycoords="axes fraction",
        textcoords="offset points",
        fontsize=8.5,
        color=INK if relation.clear else MUTED,
        linespacing=1.3,
    )


def _unit(relation: Relation) -> tuple[float, str]:
    """The factor to a unit in which the component is of everyday size, and its name."""
    unit = "N" if relation.component.startswith("force") else "N m"
    size = float(np.quantile(np.abs(relation.points[:, 1]), 0.9))
    if size > 0.3:
        return 1.0, unit
    return (1e3, f"m{unit}") if size > 3e-4 else (1e6, f"µ{unit}")


def _summary(relation: Relation, factor: float, unit: str) -> str:
    mean = relation.means[relation.component]
    average = span(Interval(*(factor * x for x in (mean.value, mean.low, mean.high))), unit)
    r2 = relation.r2
    share = percent_span(Interval(*(max(x, 0.0) for x in (r2.value, r2.low, r2.high))))
    if relation.state_clear:
        return f"the state explains {share} of it;\nits mean is {average}"
    if relation.clear:
        return f"no state explains more than the mean,\n{average}, explains: {share}"
    return f"not significant; the best pair explains\n{share}, p = {short(relation.p_value, 2)}"


# ---------------------------------------------------------------- corners


@report_figure(
    "gap_corners",
    alt="The object's corners, coloured by their share of the gap per frame of contact, and the shares as bars.",
    detail=CORNERS,
    applies=lambda diagnosis: bool(diagnosis.place.corners) and diagnosis.verdict != "no_gap",
)
@styled
def gap_by_corner(diagnosis: Diagnosis) -> Figure:
    """The object's corners, coloured by their share of the gap in contact per frame, and the shares as bars.

    Args:
        diagnosis: What was found.
    """
    found, left = diagnosis.place.corners, diagnosis.place.corners_left if diagnosis.found else ()
    order = _named_corners(found)
    letters = {c: chr(ord("A") + i) for i, c in enumerate(order)}
    figure = new_figure(
        "The gap by corner",
        "Shares of the gap above the noise in frames with contact, by the corner that touches (equal shares where\n"
        "several do). Left: per frame of contact; 1 is the mean. Positions are in the base's frame.",
        height=2.35 + max(2.6, 0.34 * len(order)),
    )
    w, h = figure.get_size_inches()
    tall = h - 2.15
    view = figure.add_axes((0.1 / w, 0.85 / h, 3.0 / w, tall / h))
    bar = figure.add_axes((3.2 / w, 1.05 / h, 0.13 / w, (tall - 0.4) / h))
    ax = figure.add_axes((5.8 / w, 0.85 / h, 1.5 / w, tall / h))
    density = np.array([0.0 if c.per_frame is None else c.per_frame for c in found])
    norm = Normalize(0.0, max(2.0, float(density.max(initial=0.0))))
    colors = figure.colorbar(ScalarMappable(norm=norm, cmap="YlOrRd"), cax=bar)
    colors.set_label("share of the gap per frame [mean = 1]", fontsize=SMALL)
    _body(view, found, density, norm, letters)
    _shares(ax, found, left, letters)
    handles = [(Swatch(color=BEFORE), "before")]
    if left:
        handles.append((Swatch(color=AFTER), with_what(diagnosis)))
    key_row(figure, handles, y=0.92, x=4.4)
    footnote(figure, "Thin lines: 95 % intervals over tosses. 0 %: no more than noise. White: no contact.")
    return figure


def _named_corners(found: Sequence[Corner]) -> list[int]:
    """The corners that get a letter, in the order of their places."""
    most = sorted(range(len(found)), key=lambda c: -found[c].share.value)[:LETTERS]
    return sorted(most, key=lambda c: found[c].place[::-1], reverse=True)


def _body(
    ax: Axes,
    found: Sequence[Corner],
    density: Array,
    norm: Normalize,
    letters: dict[int, str],
) -> None:
    """The body in its own axes, as seen from the side and above; edges behind it are dashed."""
    ax.set_aspect("equal")
    ax.axis("off")
    places = np.array([c.place for c in found])
    view = view_from(AZIMUTH, ELEVATION)
    flat, depth = view(places), places @ view.toward
    for link in sorted({c.link for c in found}):
        own = np.array([i for i, c in enumerate(found) if c.link == link])
        frame = wireframe(places[own])
        solid = frame.normals.any()  # corners in one plane have no edges
        near = frame.visible(np.array([1.0, 0.0, 0.0, 0.0]), view.toward)
        for (i, j), front in zip(frame.edges.tolist() if solid else (), near.tolist(), strict=False):
            ax.plot(*flat[own[[i, j]]].T, color=MUTED, lw=0.9, ls="-" if front else (0, (3, 3)), zorder=1)
    colors = ScalarMappable(norm=norm, cmap="YlOrRd")
    size = np.ptp(flat, axis=0).max()
    for c in np.argsort(depth).tolist():
        none = found[c].per_frame is None
        face = "white" if none else colors.to_rgba(density[c])
        ax.scatter(flat[c, 0], flat[c, 1], s=240 if c in letters else 60, color=[face], edgecolors=INK, linewidths=0.9)
        if c in letters:
            dark = not none and norm(density[c]) > 0.6
            x, y = flat[c]
            ax.text(x, y, letters[c], ha="center", va="center_baseline", weight="bold", color="white" if dark else INK)
    origin = places.mean(0)
    for axis, name in zip(np.eye(3), "xyz", strict=True):
        tip = view(np.stack([origin, origin + 0.28 * size * axis]))
        ax.annotate("", tip[1], tip[0], arrowprops={"arrowstyle": "->", "color": MUTED, "lw": 1.0})
        x, y = tip[0] + 1.22 * (tip[1] - tip[0])
        ax.text(x, y, name, color=MUTED, fontsize=SMALL, ha="center", va="center")
    ax.margins(0.16)


def _shares(ax: Axes, found: Sequence[Corner], left: Sequence[Corner], letters: dict[int, str]) -> None:
    rows = np.arange(len(letters))[::-1]
    values = [found[c].share for c in letters]
    most = max(0.05, *(s.value for s in values))
    end = 100 * min(1.05 * max(most, *(s.high for s in values)), 2.5 * most)
    for row, c in zip(rows, letters, strict=True):
        both = [(found[c].share, BEFORE, 0.18 if left else 0.0)]
        if left:
            both.append((left[c].share, AFTER, -0.18))
        for share, color, off in both:
            ax.barh(row + off, min(100 * share.value, end), height=0.32, color=color, alpha=0.85)
            ends = np.clip([100 * share.low, 100 * share.high], 0.0, end)
            ax.plot(ends, [row + off, row + off], color=INK, lw=0.9)
        text = " → ".join(f"{100 * share.value:.0f}" for share, _, _ in both)
        frames = "1 frame" if found[c].frames == 1 else f"{found[c].frames} frames"
        beside(ax, 1.0, row, 6, f"{text} %, {frames}", "left")
        beside(ax, 0.0, row, -7, f"{letters[c]}  {place_of(found[c].place)}", "right")
    ax.set_yticks([])
    ax.set_xlim(0.0, end)
    ax.set_ylim(-0.6, len(letters) - 0.4)
    ax.axvline(0, color=MUTED, lw=0.8)
    ax.grid(axis="y", visible=False)
    ax.set_xlabel("share of the gap\nin contact [%]")
