"""Many tosses: errors of rollouts over tosses and along them, and what tosses say of their recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.stats import t as student

from tossid.errors import InputError
from tossid.evaluation.figures.style import (
    MUTED,
    SMALL,
    axes_inches,
    footnote,
    label_ends,
    look,
    new_figure,
    number,
    panel_grid,
    spread,
    styled,
)
from tossid.evaluation.metrics import TossScores, summarize
from tossid.motion import frames_in_flight
from tossid.objects import ObjectModel, center_positions
from tossid.rotations import geodesic_angle
from tossid.types import RecordingOrder, Rollout, Toss

Array = NDArray[np.float64]

LOG_RATIO = 20.0
"""Errors are drawn on a logarithmic axis if the largest is beyond so many times the largest median."""
NAMED_OUTLIERS = 5
"""Most outliers of a model that are named."""
FEWEST_FOR_BAND = 5
"""With fewer tosses, each is drawn by itself instead of a band."""
HIGHEST_BAND = 2.5
"""Multiple of the largest mean error at which the axis cuts bands off."""
FEWEST_SHARE = 0.25
"""Times at which fewer than this share of the tosses (or fewer than two) are under way are not drawn."""
ERRORS = ("position_error_pct", "rotation_error_deg")


@styled
def errors_over_tosses(scores: Mapping[str, TossScores], names: Sequence[str]) -> Figure:
    """Every toss's mean position and rotation error as a dot, the mean with its 95 % interval, outliers by name.

    An outlier lies beyond the upper quartile by more than 1.5 times the interquartile range (Tukey 1977). Intervals are
    those of `metrics.summarize`.

    Args:
        scores: Scores by model, one value a toss (B,).
        names: Names of the tosses (B,).

    Raises:
        InputError: There are no scores, or scores and names differ in number.
    """
    for name, one in scores.items():
        if len(one.position_error_pct) != len(names) or len(one.rotation_error_deg) != len(names):
            raise InputError(f"{name} has scores of {len(one.position_error_pct)} tosses, there are {len(names)} names")
    if not scores:
        raise InputError("no scores to draw")
    count = f"{len(names)} tosses" if len(names) != 1 else "1 toss"
    subtitle = f"{count}, open-loop rollouts; each dot is a toss's mean over its frames."
    figure = new_figure("Errors over held-out tosses", subtitle, height=7.2)
    axes = panel_grid(figure, 2, 1, left=0.75, right=0.3, top=1.05, bottom=0.95, above=0.95)[:, 0]
    missing = 0
    for ax, kind, quantity, unit in zip(axes, ERRORS, ("Position", "Rotation"), ("% of width", "deg"), strict=True):
        values = {name: np.asarray(getattr(one, kind), dtype=float) for name, one in scores.items()}
        missing += sum(int((~np.isfinite(v)).sum()) for v in values.values())
        _strips(ax, values, names, f"{quantity.lower()} error", f"[{unit}]")
        ax.set_title(quantity)
    note = "Diamond and bar: mean and its 95 % interval over tosses. Line: median. Named: outliers (Tukey's rule)"
    note += f", at most {NAMED_OUTLIERS} a model."
    if missing:
        note += f"\nNot finite and left out: {missing} values."
    footnote(figure, note)
    return figure


def _strips(ax: Axes, values: Mapping[str, Array], names: Sequence[str], quantity: str, unit: str) -> None:
    """One strip of dots a model."""
    finite = {name: v[np.isfinite(v)] for name, v in values.items()}
    drawn = np.concatenate(list(finite.values()))
    typical = max([float(np.median(v)) for v in finite.values() if len(v)], default=0.0)
    logarithmic = bool(len(drawn)) and drawn.max() > LOG_RATIO * typical > 0 and drawn.min() > 0
    ax.set_xlim(-0.5, len(values) - 0.5)
    if logarithmic:
        ax.set_yscale("log")
        ax.set_ylim(drawn.min() / 1.3, drawn.max() * 1.5)
    else:
        ax.set_ylim(0, 1.1 * drawn.max() if len(drawn) and drawn.max() > 0 else 1.0)
    ax.set_ylabel(f"{quantity} {unit}" + (", log" if logarithmic else ""))
    ax.set_xlabel(f"model, mean and 95 % interval {unit}", color=MUTED, fontsize=SMALL)
    ax.grid(axis="x", visible=False)
    ax.tick_params(axis="x", length=0)
    ticks = []
    for i, (name, v) in enumerate(finite.items()):
        style = look(name, others=list(values))
        if not len(v):
            ticks.append(f"{style.label}\nnone finite")
            continue
        x = i + _swarm(ax, v)
        ax.plot(x, v, "o", ms=4, mfc=style.color, mec="white", mew=0.4, alpha=0.7, ls="none", label=name)
        ax.plot([i - 0.14, i + 0.14], [np.median(v)] * 2, color=style.color, lw=1.2, label="_median", zorder=4)
        summary = summarize(v)
        mean, (low, high) = summary["mean"], summary["ci95"]
        form: dict[str, Any] = {"color": style.color, "marker": "D", "ms": 6, "capsize": 4, "elinewidth": 2}
        ends = [[max(mean - low, 0)], [max(high - mean, 0)]]
        ax.errorbar(i - 0.24, mean, yerr=ends, zorder=5, label=f"{name} mean", **form)
        ends_words = f" [{number(low)}, {number(high)}]" if low < high else ""  # one toss has no interval
        ticks.append(f"{style.label}\n{number(mean)}{ends_words}")
        of_finite = [n for n, finite in zip(names, np.isfinite(values[name]), strict=True) if finite]
        _name_outliers(ax, i, x, v, of_finite, style.color)
    ax.set_xticks(range(len(values)), ticks)
    for tick, name in zip(ax.get_xticklabels(), values, strict=True):
        tick.set_color(look(name, others=list(values)).color)
        tick.set_fontweight("bold")


def _heights(ax: Axes, values: Array) -> Array:
    """Places of values (n,) along the y axis, as shares of its height."""
    to_axes = ax.transData + ax.transAxes.inverted()
    return np.asarray(to_axes.transform(np.column_stack([np.zeros(len(values)), values]))[:, 1])


def _swarm(ax: Axes, values: Array) -> Array:
    """Sideways shifts (n,) [x axis units, within ±0.14] that keep dots of similar height apart."""
    rows = np.floor(_heights(ax, values) * axes_inches(ax)[1] / 0.055).astype(int)
    shift = np.zeros(len(values))
    for row in np.unique(rows):
        members = np.flatnonzero(rows == row)
        order = members[np.argsort(values[members], kind="stable")]
        rank = np.arange(len(order))
        step = min(0.03, 0.28 / max(len(order) - 1, 1))
        shift[order] = step * np.where(rank % 2, (rank + 1) // 2, -(rank // 2))
    return shift


def _name_outliers(ax: Axes, i: int, x: Array, v: Array, names: Sequence[str], color: str) -> None:
    """The names of a strip's outliers to its right, moved apart, with leaders."""
    lower, upper = np.percentile(v, [25, 75])
    outside = np.flatnonzero(v > upper + 1.5 * (upper - lower))
    outside = outside[np.argsort(-v[outside], kind="stable")][:NAMED_OUTLIERS]
    gap = 11.0 / 72 / axes_inches(ax)[1]
    arrow: dict[str, Any] = {"arrowstyle": "-", "color": color, "lw": 0.6, "alpha": 0.6, "shrinkA": 1, "shrinkB": 3}
    form: dict[str, Any] = {"va": "center", "fontsize": SMALL, "color": color, "arrowprops": arrow}
    for k, y in zip(outside, spread(list(_heights(ax, v[outside])), gap, 0.5 * gap, 1.0), strict=True):
        ax.annotate(names[int(k)], (x[k], v[k]), (i + 0.2, y), textcoords=ax.get_xaxis_transform(), **form)


@dataclass(frozen=True)
class ErrorsAlong:
    """Errors of one model along its rollouts; NaN where a toss is not under way.

    Attributes:
        time: Time since first contact (n,) [s], evenly spaced.
        position_error_pct: Position errors (B, n) [% of the width].
        rotation_error_deg: Rotation errors (B, n) [deg].
    """

    time: Array
    position_error_pct: Array
    rotation_error_deg: Array


def errors_along(tosses: Sequence[Toss], rollouts: Sequence[Rollout], model: ObjectModel) -> ErrorsAlong:
    """Errors of rollouts against time since first contact, interpolated to the tosses' median frame time.

    First contact is the first frame in which the object may touch the ground; tosses without one take no part.

    Args:
        tosses: The tosses as measured.
        rollouts: A prediction of each, at its frames.
        model: The nominal object.

    Raises:
        InputError: Tosses and predictions differ in number, or no toss touches the ground.
    """
    if len(tosses) != len(rollouts):
        raise InputError(f"{len(rollouts)} rollouts of {len(tosses)} tosses")
    curves = []
    for toss, run, first in zip(tosses, rollouts, frames_in_flight(tosses, model), strict=True):
        if first < len(toss):
            apart = np.linalg.norm(center_positions(model, run.q) - center_positions(model, toss.q), axis=1)
            angle = np.rad2deg(geodesic_angle(run.q[:, 3:7], toss.q[:, 3:7]))
            curves.append((toss.t - toss.t[first], 100 * apart / model.width, angle))
    if not curves:
        raise InputError(f"none of {len(tosses)} tosses touches the ground")
    dt = float(np.median(np.concatenate([np.diff(time) for time, _, _ in curves])))
    low, high = min(c[0][0] for c in curves), max(c[0][-1] for c in curves)
    grid = dt * np.arange(np.ceil(low / dt - 1e-9), np.floor(high / dt + 1e-9) + 1)
    position, rotation = (
        np.array([np.interp(grid, c[0], c[k], left=np.nan, right=np.nan) for c in curves]) for k in (1, 2)
    )
    return ErrorsAlong(grid, position, rotation)


def mean_band(values: Array) -> tuple[Array, Array, Array]:
    """Mean over tosses with its 95 % interval (Student's t), time by time.

    Args:
        values: Values (B, n), NaN where there is none.

    Returns:
        Mean, lower and upper end, each (n,); NaN where fewer than two tosses have a value.
    """
    known = np.isfinite(values)
    count = known.sum(axis=0)
    mean = np.where(known, values, 0.0).sum(axis=0) / np.maximum(count, 1)
    variance = (np.where(known, values - mean, 0.0) ** 2).sum(axis=0) / np.maximum(count - 1, 1)
    half = student.ppf(0.975, np.maximum(count - 1, 1)) * np.sqrt(variance / np.maximum(count, 1))
    mean = np.where(count < 2, np.nan, mean)
    return mean, mean - half, mean + half


@styled
def errors_along_rollout(errors: Mapping[str, ErrorsAlong]) -> Figure:
    """Mean position and rotation error against time since first contact, with 95 % bands over tosses.

    Args:
        errors: What `errors_along` returned, by model.

    Raises:
        InputError: There are no errors.
    """
    if not errors:
        raise InputError("no errors to draw")
    n_tosses = max(len(one.position_error_pct) for one in errors.values())
    few = n_tosses < FEWEST_FOR_BAND
    words = "Thick: mean, thin: single tosses." if few else "Mean, band: 95 % over tosses."
    subtitle = f"{n_tosses} tosses, lined up at their first contact (time 0). {words}"
    figure = new_figure("How errors grow along a rollout", subtitle, height=6.9)
    axes = panel_grid(figure, 3, 1, left=0.75, right=1.05, top=1.05, bottom=0.85, above=0.5, heights=[1, 1, 0.28])[:, 0]
    ends: dict[str, list[tuple[float, float, str, str]]] = {kind: [] for kind in ERRORS}
    tops = dict.fromkeys(ERRORS, 0.0)
    times: list[float] = []
    for name, one in errors.items():
        label, color, *_ = look(name, others=list(errors))
        count = np.isfinite(one.position_error_pct).sum(axis=0)
        drawn = count >= max(2.0, FEWEST_SHARE * len(one.position_error_pct))
        if not drawn.any():
            continue
        for ax, kind in zip(axes, ERRORS, strict=False):
            values = np.where(drawn, getattr(one, kind), np.nan)
            mean, low, high = mean_band(values)
            if few:
                ax.plot(one.time, values.T, color=color, lw=0.8, alpha=0.6, label="_toss")
                top = np.nanmax(values)
            else:
                ax.fill_between(one.time, np.maximum(low, 0), high, color=color, alpha=0.18, lw=0, label=f"{name} band")
                top = min(np.nanmax(high), HIGHEST_BAND * np.nanmax(mean))
            ax.plot(one.time, mean, color=color, label=name)
            last = int(np.flatnonzero(drawn)[-1])
            ends[kind].append((float(one.time[last]), float(mean[last]), label, color))
            tops[kind] = max(tops[kind], float(top))
        axes[2].step(one.time, np.where(drawn, count, np.nan), where="mid", color=color, lw=1.2, label=name)
        times += [one.time[drawn][0], one.time[drawn][-1]]
    labels = ("position error\n[% of width]", "rotation error\n[deg]", "tosses\n[count]")
    for ax, label in zip(axes, labels, strict=True):
        ax.set_ylabel(label)
        if times:
            ax.set_xlim(min(times), max(times))
        ax.axvline(0, color=MUTED, lw=1.0, ls="--", zorder=1, label="_contact")
    for ax, kind in zip(axes, ERRORS, strict=False):
        ax.set_ylim(0, 1.05 * tops[kind] or 1.0)
        ax.tick_params(labelbottom=False)
        label_ends(ax, ends[kind])
    where: dict[str, Any] = {"xycoords": axes[0].get_xaxis_transform(), "textcoords": "offset points"}
    axes[0].annotate("first contact", (0, 1), (4, 3), color=MUTED, fontsize=SMALL, va="bottom", **where)
    if not times:
        axes[0].text(0.5, 0.5, "fewer than two tosses at any time", transform=axes[0].transAxes, ha="center")
    axes[2].set_ylim(0, 1.15 * n_tosses)
    axes[2].set_xlabel("time since first contact [s]")
    footnote(figure, f"Drawn where at least {100 * FEWEST_SHARE:g} % of the tosses are under way.")
    return figure


WITNESSES = (
    ("fall [°]", ("fall_x", "fall_y"), 180 / np.pi),
    ("resting normal [°]", ("normal_x", "normal_y"), 180 / np.pi),
    ("gravity [m/s²]", ("gravity",), 1.0),
    ("resting height [mm]", ("height",), 1e3),
)
"""What tosses say of their recording: label, quantities, and the factor from SI."""


@styled
def recording_over_order(order: RecordingOrder) -> Figure:
    """A row a witness: its components over the order of recording, and over the places where tosses ended, x and y.

    Vertical lines divide sessions.

    Args:
        order: Of a dataset, with what its tosses say as they were recorded.
    """
    n = len(order.sessions)
    subtitle = f"{n} session{'s' if n > 1 else ''} in the order of {order.ordered_by}; "
    subtitle += "components x (blue) and y (red) as recorded, and where the toss ended"
    figure = new_figure("The recording, toss by toss", subtitle, height=8.6)
    axes = panel_grid(figure, len(WITNESSES), 3, left=0.95, between=0.55)
    for row, (label, names, factor) in zip(axes, WITNESSES, strict=True):
        values = factor * order.values[:, [order.quantities.index(name) for name in names if name in order.quantities]]
        for ax, over in zip(row, (np.arange(len(order.names), dtype=float), *order.places.T), strict=True):
            for color, series in zip(("#0072B2", "#D55E00"), values.T, strict=False):
                ax.plot(over, series, ".", color=color, markersize=2.5, alpha=0.6)
            if np.isfinite(values).any():  # the middle 96 %, so that single outliers do not hide a step
                low, high = np.nanquantile(values, [0.02, 0.98])
                margin = 0.15 * (high - low) + 1e-6
                ax.set_ylim(low - margin, high + margin)
        row[0].set_ylabel(label)
        for at in np.flatnonzero(np.diff(order.session_of)):
            row[0].axvline(at + 0.5, color=MUTED, linewidth=1.0)
    for ax, label in zip(axes[-1], ("order of recording", "x of the end [m]", "y of the end [m]"), strict=True):
        ax.set_xlabel(label)
    return figure
