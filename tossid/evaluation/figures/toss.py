"""One toss: measured and predicted, and what accelerates the object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Polygon
from matplotlib.ticker import NullLocator
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from tossid.errors import InputError
from tossid.evaluation.accelerations import Accelerations
from tossid.evaluation.figures.style import (
    INK,
    LOOKS,
    MUTED,
    RULE,
    SMALL,
    axes_inches,
    footnote,
    halo,
    key_row,
    label_ends,
    look,
    new_figure,
    number,
    panel_grid,
    sample,
    styled,
)
from tossid.evaluation.figures.wireframe import posed, view_from, wireframes
from tossid.objects import GRAVITY, ObjectModel, center_positions
from tossid.rotations import geodesic_angle
from tossid.types import Phase, Rollout, Toss

Array = NDArray[np.float64]

POSES = 7
"""Poses in the film strip of a toss."""
PHASE_COLORS = {Phase.IMPACT: "#f1a58d", Phase.SLIDE: "#fde9b8", Phase.ROLL: "#cfe6d4", Phase.REST: "#e3e5ea"}


@styled
def toss_comparison(
    toss: Toss, rollouts: Mapping[str, Rollout], model: ObjectModel, *, title: str | None = None
) -> Figure:
    """A film strip of the object, and its height, horizontal distance, position and rotation error over time.

    The film strip looks at the throw from the side, its window follows the measured object, and its poses are spaced
    equally in distance and angle moved.

    Args:
        toss: The toss as measured.
        rollouts: Predictions by model name, at the toss's frames.
        model: The nominal object, whose corners, centre and width are drawn.
        title: The figure's title; the toss's name if None.

    Raises:
        InputError: A prediction has other frames than the toss.
    """
    for name, run in rollouts.items():
        if run.q.shape != toss.q.shape:
            raise InputError(f"{toss.name}: {name} predicts {run.q.shape}, the toss has {toss.q.shape}")
    looks = {name: look(name, others=list(rollouts)) for name in rollouts}
    measured = center_positions(model, toss.q)
    centers = {name: center_positions(model, run.q) for name, run in rollouts.items()}
    turned = {name: np.rad2deg(geodesic_angle(run.q[:, 3:7], toss.q[:, 3:7])) for name, run in rollouts.items()}
    apart = {name: np.linalg.norm(center - measured, axis=1) for name, center in centers.items()}
    errors = [
        f"{looks[n].label} {number(100 * apart[n].mean() / model.width, 2)} %, {number(turned[n].mean(), 2)}°"
        for n in rollouts
    ]
    subtitle = f"Mean errors over the toss, in % of the width and degrees: {';  '.join(errors)}"
    figure = new_figure(title or f"Toss {toss.name}", subtitle, height=7.6)
    frames, heading = pose_frames(toss, model, POSES), _heading(measured)
    strip = panel_grid(figure, 1, POSES, left=0.15, right=0.15, top=1.3, bottom=4.62, between=0.06)[0]
    _film_strip(strip, toss, rollouts, model, frames, heading)

    axes = panel_grid(figure, 2, 2, left=0.8, right=0.2, top=3.3, bottom=1.0, between=0.85, above=0.3)
    t, along = toss.t - toss.t[0], {name: (c[:, :2] - measured[0, :2]) @ heading for name, c in centers.items()}
    curves: list[tuple[str, Array | None, dict[str, Array]]] = [
        ("height [m]", measured[:, 2], {n: c[:, 2] for n, c in centers.items()}),
        ("distance along throw [m]", (measured[:, :2] - measured[0, :2]) @ heading, along),
        ("position error [mm]", None, {n: 1e3 * e for n, e in apart.items()}),
        ("rotation error [deg]", None, turned),
    ]
    for ax, (label, truth, predicted) in zip(axes.flat, curves, strict=True):
        _shade_phases(ax, t, toss.phase)
        if truth is not None:
            ax.plot(t, truth, color=INK, lw=2.4, label="measured")
        for name, values in predicted.items():
            ax.plot(t, values, color=looks[name].color, lw=1.6, label=name)
        if truth is None:
            ax.set_ylim(0, 1.08 * max([values.max() for values in predicted.values()], default=1.0) + 1e-9)
        ax.set_ylabel(label)
        ax.set_xlim(t[0], t[-1])
        for k in frames:
            ax.plot(t[k], 0, "|", color=MUTED, ms=5, transform=ax.get_xaxis_transform(), clip_on=False, label="_pose")
    axes[0, 0].set_ylim(bottom=0)
    for upper, lower in axes.T:
        upper.tick_params(labelbottom=False)
        lower.set_xlabel("time [s]")

    entries: list[tuple[Any, str]] = [(sample(lw=2.4), "measured")]
    entries += [(sample(looks[n].color, lw=2), looks[n].label) for n in rollouts]
    present = set(np.unique(toss.phase))
    entries += [(Patch(color=c), p.name.lower()) for p, c in PHASE_COLORS.items() if int(p) in present]
    key_row(figure, entries, y=0.75)
    note = "Poses: seen from the side, in a window that follows the measured object; spaced equally in motion, "
    footnote(figure, note + "ticks on the time axes.\nAll but what was measured is predicted, open loop.")
    return figure


def pose_frames(toss: Toss, model: ObjectModel, count: int) -> NDArray[np.int64]:
    """Frames (count,) that are equally spaced in how far the object moved: distance [half widths] plus angle [rad]."""
    distance = np.linalg.norm(np.diff(center_positions(model, toss.q), axis=0), axis=1) / (0.5 * model.width)
    angle = geodesic_angle(toss.q[1:, 3:7], toss.q[:-1, 3:7])
    moved = np.concatenate([[0.0], np.cumsum(distance + angle)])
    frames = np.searchsorted(moved, np.linspace(0, moved[-1], count), side="left")
    return np.minimum(frames, len(toss) - 1)


def _borders(t: Array) -> Array:
    """Times (n + 1,) between which frames at (n,) reach: half way to their neighbours."""
    return np.concatenate([t[:1], 0.5 * (t[1:] + t[:-1]), t[-1:]])


def _runs(values: NDArray[Any]) -> list[tuple[int, int]]:
    """(first, one past the last) of each run of equal values (n,)."""
    starts = np.flatnonzero(np.diff(values.astype(int), prepend=-1)).tolist()
    return list(zip(starts, [*starts[1:], len(values)], strict=True))


def _shade_phases(ax: Axes, t: Array, phase: NDArray[np.uint8]) -> None:
    border = _borders(t)
    for a, b in _runs(phase):
        kind = Phase(int(phase[a]))
        if kind in PHASE_COLORS:
            ax.axvspan(border[a], border[b], color=PHASE_COLORS[kind], lw=0, zorder=0, label=f"_{kind.name}")


def _heading(center: Array) -> Array:
    """Horizontal unit vector (2,) of the throw: of the largest spread, pointing to where it goes."""
    flat = center[:, :2] - center[0, :2]
    _, _, axes = np.linalg.svd(flat, full_matrices=False)
    direction = axes[0] if np.abs(flat).max() > 1e-9 else np.array([1.0, 0.0])
    return direction * (1.0 if flat[-1] @ direction >= 0 else -1.0)


def _film_strip(
    axes: NDArray[Any],
    toss: Toss,
    rollouts: Mapping[str, Rollout],
    model: ObjectModel,
    frames: NDArray[np.int64],
    heading: Array,
) -> None:
    """One window a pose: the measured object filled, predictions as outlines, the ground as a line."""
    view = view_from(np.arctan2(heading[1], heading[0]) - 0.5 * np.pi, 0.0)  # the throw goes to the right
    frames_of = wireframes(model)
    width, height = axes_inches(axes[0])
    top = max(view(np.concatenate([c for c, _ in posed(model, toss.q[k])]))[:, 1].max() for k in frames)
    wide = max(max(1.08 * top, 1.5 * model.width) * width / height, 1.9 * model.width)
    tall = wide * height / width
    centers = view(center_positions(model, toss.q))
    # measured first, then each prediction over it with thinner lines
    layers = [("measured", toss.q, INK, 1.0)]
    layers += [
        (name, run.q, look(name, others=list(rollouts)).color, max(2.2 - 0.8 * i, 1.0))
        for i, (name, run) in enumerate(rollouts.items())
    ]
    for ax, k in zip(axes, frames, strict=True):
        ax.axhspan(-0.06 * tall, 0, color="#d9dce1", lw=0, zorder=0)
        ax.axhline(0, color=MUTED, lw=0.9, zorder=1)
        for layer, (name, q, color, line) in enumerate(layers):
            for frame, (corners, quat) in zip(frames_of, posed(model, q[k]), strict=True):
                flat = view(corners)
                if not layer:
                    outline = flat[ConvexHull(flat).vertices]
                    ax.add_patch(Polygon(outline, closed=True, fc="#c9ccd2", ec="none", alpha=0.75, zorder=2))
                edges = list(flat[frame.edges[frame.visible(quat, view.toward)]])
                visible = LineCollection(edges, colors=color, linewidths=line, zorder=3 + layer, label=name)
                ax.add_collection(visible, autolim=False)
        ax.set_xlim(centers[k, 0] - 0.5 * wide, centers[k, 0] + 0.5 * wide)
        ax.set_ylim(-0.06 * tall, 0.94 * tall)
        ax.set_axis_off()
        ax.set_title(f"{toss.t[k] - toss.t[0]:.2f} s", loc="center", fontsize=9, fontweight="normal", pad=4)


LINEAR = 15.0
"""Panels with contact are linear up to this [m/s²] and logarithmic beyond: impacts are tens of times gravity."""


@styled
def residual_over_toss(parts: Accelerations, *, title: str = "What accelerates the object", name: str = "") -> Figure:
    """Vertical accelerations over one toss (Bianchini and Posa 2023, Figure 2).

    Four series over a common time: the given continuous dynamics k_hat (gravity), the learned k_res, the contact
    impulses as (1/m) sum(lam_n) / dt, and the sum of the three against the measured acceleration, the difference of
    measured velocities over dt. In sustained contact the data determine only the sum of k_res and contact: there the
    series are hatched.

    Args:
        parts: Of `accelerations_over_toss`.
        title: The figure's title.
        name: The toss's name, for the subtitle.
    """
    t, given, residual, contact, measured = parts.t, parts.given, parts.residual, parts.contact, parts.measured
    flown = np.cumprod(parts.separable & (np.abs(contact) < 1e-9)).astype(bool)
    subtitle = f"Toss {name}.  " if name else ""
    if flown.any():
        means = [number(float(np.mean(part[flown]))) for part in (given, given + residual, measured)]
        subtitle += "Mean before first contact: given {}, with the learned part {}, measured {} m/s².".format(*means)
    figure = new_figure(title, subtitle, height=7.6)
    rows = (
        ("Given continuous dynamics", [("given", given, "#0072B2", 1.8)]),
        ("Learned acceleration", [("residual", residual, "#009E73", 1.8)]),
        ("Contact impulses / (m Δt)", [("contact", contact, "#D55E00", 1.5)]),
        (
            "Sum against measurement",
            [("measured", measured, INK, 2.6), ("sum", given + residual + contact, LOOKS["cnrp"].color, 1.2)],
        ),
    )
    heights = [0.8, 0.8, 1.1, 1.3]
    axes = panel_grid(figure, 4, 1, left=0.8, right=1.35, top=1.05, bottom=0.85, above=0.42, heights=heights)[:, 0]
    # common limits of the two continuous parts, with zero and what they should be inside
    values = np.r_[0.0, given, residual, -GRAVITY, -GRAVITY - given]
    low, high = np.nanmin(values), np.nanmax(values)
    room = 0.12 * (high - low) or 1.0
    for i, (ax, (heading, lines)) in enumerate(zip(axes, rows, strict=True)):
        ax.set_title(heading)
        ax.set_ylabel("acceleration\n[m/s²]" + (", symlog" if i > 1 else ""))
        ax.set_xlim(t[0], t[-1])
        ax.axhline(0, color=RULE, lw=0.7, zorder=1, label="_zero")
        for key, series, color, width in lines:
            ax.plot(t, series, color=color, lw=width, label=key)
        if i < 2:
            ax.set_ylim(low - room, high + 1.6 * room)
        else:
            _symlog(ax, np.concatenate([series for _, series, _, _ in lines]))
        _hatch(ax, _borders(t), parts.separable, avoid=lines[0][1] if i in (1, 2) else None)
        label_ends(ax, [(t[-1], series[-1], key, color) for key, series, color, _ in lines])
        ax.tick_params(labelbottom=i == 3)
    missing = -GRAVITY - float(np.mean(given))
    for ax, level, label, text in (
        (axes[0], -GRAVITY, "true", "true in flight"),
        (axes[1], missing, "missing", "what is missing"),
    ):
        ax.axhline(level, color=MUTED, ls="--", lw=1.1, label=label, zorder=2)
        where: dict[str, Any] = {"xycoords": ax.get_yaxis_transform(), "textcoords": "offset points", "va": "bottom"}
        halo(ax.annotate(f"{text}: {number(level)}", (0, level), (5, 3), fontsize=SMALL, color=MUTED, **where))
    axes[3].set_xlabel("time [s]")
    if not parts.separable.all():
        note = "Hatched: sustained contact. There the data determine only the sum of learned acceleration and contact."
        footnote(figure, note)
    return figure


def _symlog(ax: Axes, values: Array) -> None:
    """A symmetric logarithmic axis that holds impacts and free fall at once."""
    ax.set_yscale("symlog", linthresh=LINEAR, linscale=1.0)
    low, high = min(-LINEAR, 1.5 * float(np.nanmin(values))), max(LINEAR, 1.5 * float(np.nanmax(values)))
    ax.set_ylim(low, high)
    ticks = [sign * v for v in (10, 100, 1000) for sign in (-1, 1)]
    ax.set_yticks([0, *[v for v in ticks if low <= v <= high]])
    ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}".replace("-", "−"))
    ax.yaxis.set_minor_locator(NullLocator())


def _hatch(ax: Axes, border: Array, separable: NDArray[np.bool_], *, avoid: Sequence[float] | Array | None) -> None:
    """Hatch the spans that are not separable; label the longest, away from the series `avoid` (n,)."""
    spans = [(a, b) for a, b in _runs(separable) if not separable[a]]
    form: dict[str, Any] = {"facecolor": "#f1f2f4", "edgecolor": "#b9bec6", "hatch": "////", "lw": 0, "zorder": 0}
    for a, b in spans:
        ax.axvspan(border[a], border[b], label="not separable", **form)
    if not spans or avoid is None:
        return
    a, b = max(spans, key=lambda span: float(border[span[1]] - border[span[0]]))
    to_axes = ax.transData + ax.transAxes.inverted()
    high = to_axes.transform((border[a], float(np.mean(avoid[a:b]))))[1] > 0.5
    left, right = ax.get_xlim()
    margin = 0.08 * (right - left)
    center = min(max(0.5 * (border[a] + border[b]), left + margin), right - margin)
    form = {"ha": "center", "va": "bottom" if high else "top", "fontsize": SMALL, "style": "italic", "color": MUTED}
    halo(ax.text(center, 0.1 if high else 0.9, "not separable", transform=ax.get_xaxis_transform(), **form))
