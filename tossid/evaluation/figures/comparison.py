"""One toss: measured and predicted, as curves and as a film strip."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from tossid.errors import InputError
from tossid.evaluation.figures.style import (
    INK,
    MUTED,
    axes_inches,
    footnote,
    key_row,
    look,
    new_figure,
    number,
    panel_grid,
    styled,
)
from tossid.evaluation.figures.wireframe import View, Wireframe, posed, view_from, wireframe
from tossid.objects import ObjectModel, center_positions
from tossid.rotations import geodesic_angle
from tossid.settings.figures import FigureSettings
from tossid.types import Phase, Rollout, Toss

Array = NDArray[np.float64]

PHASE_COLORS = {
    Phase.IMPACT: "#f1a58d",
    Phase.SLIDE: "#fde9b8",
    Phase.ROLL: "#cfe6d4",
    Phase.REST: "#e3e5ea",
}


@styled
def toss_comparison(
    toss: Toss,
    rollouts: Mapping[str, Rollout],
    model: ObjectModel,
    *,
    title: str | None = None,
    settings: FigureSettings = FigureSettings(),
) -> Figure:
    """A film strip of the object, and its height, horizontal distance, position and rotation error over time.

    The film strip looks at the throw from the side, its window follows the measured object, and its poses are spaced
    equally in distance and angle moved.

    Args:
        toss: The toss as measured.
        rollouts: Predictions by model name, at the toss's frames.
        model: The nominal object, whose corners, centre and width are drawn.
        title: The figure's title; the toss's name if None.
        settings: How many poses the film strip has.

    Returns:
        The figure.

    Raises:
        InputError: A prediction has other frames than the toss.
    """
    for name, run in rollouts.items():
        if run.q.shape != toss.q.shape:
            raise InputError(f"{toss.name}: {name} predicts {run.q.shape}, the toss has {toss.q.shape}")
    measured = center_positions(model, toss.q)
    centers = {name: center_positions(model, run.q) for name, run in rollouts.items()}
    turned = {name: np.rad2deg(geodesic_angle(run.q[:, 3:7], toss.q[:, 3:7])) for name, run in rollouts.items()}
    apart = {name: np.linalg.norm(center - measured, axis=1) for name, center in centers.items()}
    looks = {name: look(name, others=list(rollouts)) for name in rollouts}
    way = _way(measured)
    t = toss.t - toss.t[0]

    words = ";  ".join(
        f"{looks[n].label}: {number(100 * apart[n].mean() / model.width, 2)} % of the width, "
        f"{number(turned[n].mean(), 2)}°"
        for n in rollouts
    )
    figure = new_figure(title or f"Toss {toss.name}", f"Mean errors over the toss: {words}", height=7.6)
    frames = pose_frames(toss, model, settings.poses)
    strip = panel_grid(figure, 1, settings.poses, left=0.15, right=0.15, top=1.3, bottom=4.62, between=0.06)[0]
    _film_strip(strip, toss, rollouts, model, frames, way)

    axes = panel_grid(figure, 2, 2, left=0.8, right=0.2, top=3.3, bottom=1.0, between=0.85, above=0.3)
    curves: list[tuple[Any, str, Array | None, dict[str, Array]]] = [
        (axes[0, 0], "height [m]", measured[:, 2], {n: c[:, 2] for n, c in centers.items()}),
        (axes[0, 1], "distance along throw [m]", _along(measured, measured, way),
         {n: _along(c, measured, way) for n, c in centers.items()}),
        (axes[1, 0], "position error [mm]", None, {n: 1e3 * e for n, e in apart.items()}),
        (axes[1, 1], "rotation error [deg]", None, turned),
    ]  # fmt: skip
    for ax, label, truth, predicted in curves:
        shade_phases(ax, t, toss.phase)
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
    for ax in axes[1]:
        ax.set_xlabel("time [s]")
    for ax in axes[0]:
        ax.tick_params(labelbottom=False)

    entries: list[tuple[Any, str]] = [(Line2D([], [], color=INK, lw=2.4), "measured")]
    entries += [(Line2D([], [], color=looks[n].color, lw=2), f"{looks[n].label}, predicted") for n in rollouts]
    present = set(np.unique(toss.phase))
    entries += [(Patch(color=c), p.name.lower()) for p, c in PHASE_COLORS.items() if int(p) in present]
    key_row(figure, entries, y=0.75)
    footnote(
        figure,
        "Poses: seen from the side, in a window that follows the measured object; spaced equally in motion, "
        "ticks on the time axes.\nPredictions run open loop.",
    )
    return figure


def pose_frames(toss: Toss, model: ObjectModel, count: int) -> NDArray[np.int64]:
    """Frames that are equally spaced in how far the object moved: distance [half widths] plus angle [rad].

    Args:
        toss: The toss.
        model: The object.
        count: How many frames.

    Returns:
        The frames (count,), increasing.
    """
    way = np.linalg.norm(np.diff(center_positions(model, toss.q), axis=0), axis=1) / (0.5 * model.width)
    angle = geodesic_angle(toss.q[1:, 3:7], toss.q[:-1, 3:7])
    moved = np.concatenate([[0.0], np.cumsum(way + angle)])
    frames = np.searchsorted(moved, np.linspace(0, moved[-1], count), side="left")
    return np.minimum(frames, len(toss) - 1)


def shade_phases(ax: Axes, t: Array, phase: NDArray[np.uint8]) -> None:
    """Shade the contact phases; a frame's phase reaches half way to its neighbours.

    Args:
        ax: The axes.
        t: Times (n,) [s].
        phase: Phases (n,).
    """
    border = np.concatenate([t[:1], 0.5 * (t[1:] + t[:-1]), t[-1:]])
    starts = np.flatnonzero(np.diff(phase.astype(int), prepend=-1))
    for a, b in zip(starts, [*starts[1:], len(t)], strict=True):
        color = PHASE_COLORS.get(Phase(int(phase[a])))
        if color:
            ax.axvspan(border[a], border[b], color=color, lw=0, zorder=0, label=f"_{Phase(int(phase[a])).name}")


def _way(center: Array) -> Array:
    """Horizontal unit vector (2,) of the throw: of the largest spread, pointing to where it goes."""
    flat = center[:, :2] - center[0, :2]
    _, _, axes = np.linalg.svd(flat, full_matrices=False)
    direction = axes[0] if np.abs(flat).max() > 1e-9 else np.array([1.0, 0.0])
    return direction * (1.0 if flat[-1] @ direction >= 0 else -1.0)


def _along(center: Array, measured: Array, way: Array) -> Array:
    """(n,) horizontal way [m] from the measured start along the throw."""
    return (center[:, :2] - measured[0, :2]) @ way


def _film_strip(
    axes: NDArray[Any],
    toss: Toss,
    rollouts: Mapping[str, Rollout],
    model: ObjectModel,
    frames: NDArray[np.int64],
    way: Array,
) -> None:
    """One window a pose: the measured object filled, predictions as outlines, the ground as a line."""
    view = view_from(np.arctan2(way[1], way[0]) - 0.5 * np.pi, 0.0)  # the throw goes to the right
    drawn = model.drawn
    frames_of = [wireframe(drawn.corner_pos[drawn.corner_body == b]) for b in range(model.n_bodies)]
    width, height = axes_inches(axes[0])
    points = {
        k: [
            view(np.concatenate([c for c, _ in posed(model, q)]))
            for q in (toss.q[k], *(r.q[k] for r in rollouts.values()))
        ]
        for k in frames
    }
    top = max(p[..., 1].max() for ps in points.values() for p in ps[:1])
    tall = max(1.08 * top, 1.5 * model.width)
    wide = max(tall * width / height, 1.9 * model.width)
    tall = wide * height / width
    centers = view(center_positions(model, toss.q))
    for ax, k in zip(axes, frames, strict=True):
        ax.axhspan(-0.06 * tall, 0, color="#d9dce1", lw=0, zorder=0)
        ax.axhline(0, color=MUTED, lw=0.9, zorder=1)
        for b, (corners, quat) in enumerate(posed(model, toss.q[k])):
            _solid(ax, corners, quat, frames_of[b], view)
        for i, (name, run) in enumerate(rollouts.items()):
            color = look(name, others=list(rollouts)).color
            for b, (corners, quat) in enumerate(posed(model, run.q[k])):
                seen = frames_of[b].edges[frames_of[b].visible(quat, view.toward)]
                ax.add_collection(
                    LineCollection(
                        list(view(corners)[seen]),
                        colors=color,
                        linewidths=max(2.2 - 0.8 * i, 1.0),
                        zorder=4 + i,
                        label=name,
                    ),
                    autolim=False,
                )
        ax.set_xlim(centers[k, 0] - 0.5 * wide, centers[k, 0] + 0.5 * wide)
        ax.set_ylim(-0.06 * tall, 0.94 * tall)
        ax.set_axis_off()
        ax.set_title(f"{toss.t[k] - toss.t[0]:.2f} s", loc="center", fontsize=9, fontweight="normal", pad=4)


def _solid(ax: Axes, corners: Array, quat: Array, frame: Wireframe, view: View) -> None:
    """The measured body: its silhouette filled, its visible edges dark."""
    flat = view(corners)
    ax.add_patch(Polygon(flat[ConvexHull(flat).vertices], closed=True, fc="#c9ccd2", ec="none", alpha=0.75, zorder=2))
    seen = frame.edges[frame.visible(quat, view.toward)]
    ax.add_collection(
        LineCollection(list(flat[seen]), colors=INK, linewidths=1.0, zorder=3, label="measured"), autolim=False
    )
