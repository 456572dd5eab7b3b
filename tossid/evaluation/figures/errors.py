"""Errors of rollouts: over tosses, and along them."""

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
    Look,
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
from tossid.settings.figures import FigureSettings
from tossid.types import Rollout, Toss

Array = NDArray[np.float64]


@styled
def errors_over_tosses(
    scores: Mapping[str, TossScores],
    names: Sequence[str],
    *,
    settings: FigureSettings = FigureSettings(),
) -> Figure:
    """Every toss's mean position and rotation error as a dot, the mean with its 95 % interval, outliers by name.

    An outlier lies beyond the upper quartile by more than 1.5 times the interquartile range (Tukey 1977). Intervals are
    those of `metrics.summarize`.

    Args:
        scores: Scores by model, one value a toss (B,).
        names: Names of the tosses (B,).
        settings: Which outliers are named, and when axes are logarithmic.

    Returns:
        The figure.

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
    for ax, kind, label in (
        (axes[0], "position_error_pct", "position error [% of width]"),
        (axes[1], "rotation_error_deg", "rotation error [deg]"),
    ):
        values = {name: np.asarray(getattr(one, kind), dtype=float) for name, one in scores.items()}
        missing += sum(int((~np.isfinite(v)).sum()) for v in values.values())
        _strips(ax, values, names, label, settings)
    axes[0].set_title("Position")
    axes[1].set_title("Rotation")
    note = "Diamond and bar: mean and its 95 % interval over tosses. Line: median. Named: outliers (Tukey's rule)"
    note += f", at most {settings.named_outliers} a model."
    if missing:
        note += f" Not finite and left out: {missing} values."
    footnote(figure, note)
    return figure


def _strips(ax: Axes, values: Mapping[str, Array], names: Sequence[str], label: str, settings: FigureSettings) -> None:
    """One strip of dots a model."""
    finite = {name: v[np.isfinite(v)] for name, v in values.items()}
    drawn = np.concatenate(list(finite.values()))
    typical = max([float(np.median(v)) for v in finite.values() if len(v)], default=0.0)
    logarithmic = bool(len(drawn)) and drawn.max() > settings.log_ratio * typical > 0 and drawn.min() > 0
    ax.set_xlim(-0.5, len(values) - 0.5)
    if logarithmic:
        ax.set_yscale("log")
        ax.set_ylim(drawn.min() / 1.3, drawn.max() * 1.5)
    else:
        ax.set_ylim(0, 1.1 * drawn.max() if len(drawn) and drawn.max() > 0 else 1.0)
    ax.set_ylabel(label + (", log" if logarithmic else ""))
    ax.grid(axis="x", visible=False)
    ticks = []
    for i, (name, all_values) in enumerate(values.items()):
        style = look(name, others=list(values))
        kept = np.isfinite(all_values)
        v = all_values[kept]
        if not len(v):
            ticks.append(f"{style.label}\nnone finite")
            continue
        x = i + _swarm(ax, v)
        ax.plot(x, v, "o", ms=4, mfc=style.color, mec="white", mew=0.4, alpha=0.7, ls="none", label=name)
        ax.plot([i - 0.14, i + 0.14], [np.median(v)] * 2, color=style.color, lw=1.2, label="_median", zorder=4)
        summary = summarize(v)
        mean, (low, high) = summary["mean"], summary["ci95"]
        ax.errorbar(
            i - 0.24, mean, yerr=[[max(mean - low, 0)], [max(high - mean, 0)]], color=style.color, marker="D", ms=6,
            capsize=4, elinewidth=2, zorder=5, label=f"{name} mean",
        )  # fmt: skip
        ticks.append(f"{style.label}\n{number(mean)} [{number(low)}, {number(high)}]")
        _name_outliers(
            ax, i, x, v, [n for n, keep in zip(names, kept, strict=True) if keep], style, settings.named_outliers
        )
    ax.set_xticks(range(len(values)), ticks)
    ax.tick_params(axis="x", length=0)
    for tick, name in zip(ax.get_xticklabels(), values, strict=True):
        tick.set_color(look(name, others=list(values)).color)
        tick.set_fontweight("bold")
    unit = label[label.index("[") :]
    ax.set_xlabel(f"model, mean and 95 % interval {unit}", color=MUTED, fontsize=8.5)


def _swarm(ax: Axes, values: Array) -> Array:
    """Sideways shifts (n,) [x axis units, within ±0.14] that keep dots of similar height apart."""
    _, height = axes_inches(ax)
    transform = ax.transData + ax.transAxes.inverted()
    y = transform.transform(np.column_stack([np.zeros(len(values)), values]))[:, 1] * height
    shift = np.zeros(len(values))
    rows = np.floor(y / 0.055).astype(int)
    for row in np.unique(rows):
        members = np.flatnonzero(rows == row)
        order = members[np.argsort(values[members], kind="stable")]
        step = min(0.03, 0.28 / max(len(order) - 1, 1))
        rank = np.arange(len(order))
        shift[order] = step * np.where(rank % 2, (rank + 1) // 2, -(rank // 2))
    return shift


def _name_outliers(ax: Axes, i: int, x: Array, v: Array, names: Sequence[str], style: Look, most: int) -> None:
    """The names of a strip's outliers to its right, moved apart, with leaders."""
    lower, upper = np.percentile(v, [25, 75])
    outside = np.flatnonzero(v > upper + 1.5 * (upper - lower))
    outside = outside[np.argsort(-v[outside], kind="stable")][:most]
    if not len(outside):
        return
    _, height = axes_inches(ax)
    transform = ax.transData + ax.transAxes.inverted()
    at = transform.transform(np.column_stack([x[outside], v[outside]]))[:, 1]
    gap = 11.0 / 72 / height
    place = spread(list(at), gap, 0.5 * gap, 1.0)
    for k, to in zip(outside, place, strict=True):
        ax.annotate(
            names[int(k)],
            (x[k], v[k]),
            (i + 0.2, to),
            textcoords=ax.get_xaxis_transform(),
            va="center",
            fontsize=8.5,
            color=style.color,
            arrowprops={"arrowstyle": "-", "color": style.color, "lw": 0.6, "alpha": 0.6, "shrinkA": 1, "shrinkB": 3},
        )


@dataclass(frozen=True)
class ErrorsAlong:
    """Errors of one model along its rollouts.

    Attributes:
        time: Time since first contact (n,) [s], evenly spaced.
        position_error_pct: Position errors (B, n) [% of the width]; NaN where a toss is not under way.
        rotation_error_deg: Rotation errors (B, n) [deg]; NaN where a toss is not under way.
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

    Returns:
        The errors.

    Raises:
        InputError: Tosses and predictions differ in number, or no toss touches the ground.
    """
    if len(tosses) != len(rollouts):
        raise InputError(f"{len(rollouts)} rollouts of {len(tosses)} tosses")
    curves = []
    for toss, run, first in zip(tosses, rollouts, frames_in_flight(tosses, model), strict=True):
        if first >= len(toss):
            continue
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
    there = np.isfinite(values)
    count = there.sum(axis=0)
    filled = np.where(there, values, 0.0)
    mean = filled.sum(axis=0) / np.maximum(count, 1)
    square = (np.where(there, values - mean, 0.0) ** 2).sum(axis=0) / np.maximum(count - 1, 1)
    half = student.ppf(0.975, np.maximum(count - 1, 1)) * np.sqrt(square / np.maximum(count, 1))
    few = count < 2
    return np.where(few, np.nan, mean), np.where(few, np.nan, mean - half), np.where(few, np.nan, mean + half)


@styled
def errors_along_rollout(
    errors: Mapping[str, ErrorsAlong],
    *,
    settings: FigureSettings = FigureSettings(),
) -> Figure:
    """Mean position and rotation error against time since first contact, with 95 % bands over tosses.

    Args:
        errors: What `errors_along` returned, by model.
        settings: From how many tosses on times and bands are drawn.

    Returns:
        The figure.

    Raises:
        InputError: There are no errors.
    """
    if not errors:
        raise InputError("no errors to draw")
    n_tosses = max(len(one.position_error_pct) for one in errors.values())
    few = n_tosses < settings.fewest_for_band
    words = "Thick: mean, thin: single tosses." if few else "Mean, band: 95 % over tosses."
    subtitle = f"{n_tosses} tosses, lined up at their first contact (time 0). {words}"
    figure = new_figure("How errors grow along a rollout", subtitle, height=6.9)
    axes = panel_grid(figure, 3, 1, left=0.75, right=1.05, top=1.05, bottom=0.85, above=0.5, heights=[1, 1, 0.28])[:, 0]
    start, end = np.inf, -np.inf
    ends: dict[str, list[tuple[float, float, str, str]]] = {"position_error_pct": [], "rotation_error_deg": []}
    tops: dict[str, float] = dict.fromkeys(ends, 0.0)
    for name, one in errors.items():
        style = look(name, others=list(errors))
        count = np.isfinite(one.position_error_pct).sum(axis=0)
        drawn = count >= max(2.0, settings.fewest_share * len(one.position_error_pct))
        if not drawn.any():
            continue
        for ax, kind in zip(axes, ends, strict=False):
            values = np.where(drawn, getattr(one, kind), np.nan)
            mean, low, high = mean_band(values)
            if few:
                ax.plot(one.time, values.T, color=style.color, lw=0.8, alpha=0.6, label="_toss")
                top = np.nanmax(values)
            else:
                ax.fill_between(
                    one.time, np.maximum(low, 0), high, color=style.color, alpha=0.18, lw=0, label=f"{name} band"
                )
                top = min(np.nanmax(high), settings.highest_band * np.nanmax(mean))
            ax.plot(one.time, mean, color=style.color, label=name)
            last = int(np.flatnonzero(drawn)[-1])
            ends[kind].append((float(one.time[last]), float(mean[last]), style.label, style.color))
            tops[kind] = max(tops[kind], float(top))
        axes[2].step(one.time, np.where(drawn, count, np.nan), where="mid", color=style.color, lw=1.2, label=name)
        start, end = min(start, one.time[drawn][0]), max(end, one.time[drawn][-1])
    labels: tuple[Any, ...] = ("position error\n[% of width]", "rotation error\n[deg]", "tosses\n[count]")
    for ax, label in zip(axes, labels, strict=True):
        ax.set_ylabel(label)
        if np.isfinite(start):
            ax.set_xlim(start, end)
        ax.axvline(0, color=MUTED, lw=1.0, ls="--", zorder=1, label="_contact")
    for ax, kind in zip(axes, ends, strict=False):
        ax.set_ylim(0, 1.05 * tops[kind] or 1.0)
        ax.tick_params(labelbottom=False)
        label_ends(ax, ends[kind])
    axes[0].annotate(
        "first contact", (0, 1), (4, 3), xycoords=axes[0].get_xaxis_transform(), textcoords="offset points",
        color=MUTED, fontsize=8.5, va="bottom",
    )  # fmt: skip
    if not np.isfinite(start):
        axes[0].text(0.5, 0.5, "fewer than two tosses at any time", transform=axes[0].transAxes, ha="center")
    axes[2].set_ylim(0, 1.15 * n_tosses)
    axes[2].set_xlabel("time since first contact [s]")
    footnote(figure, f"Drawn where at least {100 * settings.fewest_share:g} % of the tosses are under way.")
    return figure
