"""Figures among the report's details: the residual wrench over the state, and the gap by corner of the object."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tossid.diagnosis.localisation.place import Corner, Relation
from tossid.diagnosis.report.figures import colour_key, share_rows
from tossid.diagnosis.report.registry import report_figure
from tossid.diagnosis.report.units import place_of
from tossid.diagnosis.report.words import state_words, wrench_words
from tossid.diagnosis.result import Diagnosis
from tossid.evaluation.figures.style import INK, MUTED, SMALL, footnote, new_figure, panel_grid, styled
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
        columns.append(("after", place.wrench_left))
    phases = [phase for phase in COLORS if any(r.phase == phase for _, found in columns for r in found)]
    figure = new_figure(
        "The residual force or torque",
        "What would remove a window's residuals, over the state that explains most of it.\n"
        "Dots: windows, with standard errors. Line: the fitted dependence, or the mean.",
        height=1.25 + 2.75 * len(phases),
    )
    axes = panel_grid(figure, len(phases), len(columns), left=0.85, top=1.25, bottom=0.95, between=1.0, above=0.95)
    for i, phase in enumerate(phases):
        for j, (when, found) in enumerate(columns):
            relation = next((r for r in found if r.phase == phase), None)
            _relation(axes[i, j], f"In {phase}, {when}", relation, COLORS[phase])
    footnote(figure, "Bands: 95 % intervals over tosses.")
    return figure


def _relation(ax: Axes, title: str, relation: Relation | None, color: str) -> None:
    ax.set_title(title)
    if relation is None:
        ax.axis("off")
        ax.text(0.5, 0.5, "too few windows to estimate a force", ha="center", va="center", color=MUTED)
        return
    x, y, error, _ = relation.points[relation.points[:, 2] < 4 * np.median(relation.points[:, 2])].T
    ax.errorbar(x, y, error, fmt="o", ms=3.5, color=color, elinewidth=0.8, alpha=0.6)
    grid, fitted, low, high = relation.curve.T
    if relation.state_clear:
        ax.fill_between(grid, low, high, color=INK, alpha=0.12, lw=0)
        ax.plot(grid, fitted, color=INK, lw=1.6)
    elif relation.clear:
        mean = relation.means[relation.component]
        ax.axhspan(mean.low, mean.high, color=INK, alpha=0.12, lw=0)
        ax.axhline(mean.value, color=INK, lw=1.6)
    else:
        ax.set_title(f"{title}: not significant", color=MUTED)
    ax.axhline(0, color=MUTED, lw=0.8, ls="--")
    low_y, high_y = min(np.percentile(y, DRAWN[0]), 0.0), max(np.percentile(y, DRAWN[1]), 0.0)
    room = 0.12 * max(high_y - low_y, 1e-9)
    ax.set_ylim(low_y - room, high_y + room)
    ax.yaxis.set_major_formatter("{x:g}")
    name, of = state_words(relation.state)
    ax.set_xlabel(f"{name} [{of}]")
    unit = "N" if relation.component.startswith("force") else "N m"
    ax.set_ylabel(f"{wrench_words(relation.component)} [{unit}]")


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
    most = sorted(range(len(found)), key=lambda c: -found[c].share.value)[:LETTERS]
    in_place = sorted(most, key=lambda c: found[c].place[::-1], reverse=True)
    letters = {c: chr(ord("A") + i) for i, c in enumerate(in_place)}
    figure = new_figure(
        "The gap by corner",
        "Shares of the gap above the noise in frames with contact, by the corner that touches (equal shares where\n"
        "several do). Left: per frame of contact; 1 is the mean. Positions are in the base's frame.",
        height=2.35 + max(2.6, 0.34 * len(letters)),
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
    share_rows(
        ax,
        [f"{letter}  {place_of(found[c].place)}" for c, letter in letters.items()],
        [found[c].share for c in letters],
        [left[c].share for c in letters] if left else (),
        [f"{found[c].frames} frames" for c in letters],
    )
    ax.set_xlabel("share of the gap\nin contact [%]")
    colour_key(figure, y=0.92, x=4.4, after=bool(left))
    footnote(figure, "Thin lines: 95 % intervals over tosses. 0 %: no more than noise. White: no contact.")
    return figure


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
    for c in np.argsort(depth).tolist():
        none = found[c].per_frame is None
        face = "white" if none else colors.to_rgba(density[c])
        ax.scatter(flat[c, 0], flat[c, 1], s=240 if c in letters else 60, color=[face], edgecolors=INK, linewidths=0.9)
        if c in letters:
            dark = not none and norm(density[c]) > 0.6
            x, y = flat[c]
            ax.text(x, y, letters[c], ha="center", va="center_baseline", weight="bold", color="white" if dark else INK)
    ax.margins(0.16)
