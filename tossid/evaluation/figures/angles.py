"""Learned geometry of an object with joints against the true one, at several joint angles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.evaluation.figures.style import INK, LOOKS, footnote, key_row, new_figure, number, panel_grid, styled
from tossid.evaluation.figures.wireframe import posed, view_from, wireframe
from tossid.objects import ObjectModel

Array = NDArray[np.float64]


@styled
def geometry_at_angles(
    truth: ObjectModel,
    learned: ObjectModel,
    *,
    seen: NDArray[np.bool_],
    angles: Sequence[float] = (-2.0, -1.0, 0.0, 1.0, 2.0),
    truth_name: str = "true",
    title: str = "Learned geometry",
) -> Figure:
    """The object at each joint angle: true edges, learned edges, and which corners ever touched the ground.

    Args:
        truth: The true object, or the stated one.
        learned: The same object with learned corners.
        seen: Corners (n_c,) that carried load in the training tosses; the places of the others are not known.
        angles: Angles of the hinges [rad]; all joints take the same.
        truth_name: What the first object is called ("true", "as published").
        title: The figure's title.

    Returns:
        The figure.

    Raises:
        InputError: The objects have different corners, or no joints.
    """
    if truth.corner_pos.shape != learned.corner_pos.shape or seen.shape != (truth.n_corners,) or not truth.n_joints:
        raise InputError("geometry at joint angles needs two objects with the same corners, and joints")
    off = 1e3 * np.linalg.norm(learned.corner_pos - truth.corner_pos, axis=1)
    words = f"{int(seen.sum())} of {len(seen)} corners touched the ground"
    if seen.any():
        words += (
            f": at most {number(off[seen].max(), 2)} mm from {truth_name}, {number(off[seen].mean(), 2)} mm on average"
        )
    figure = new_figure(title, words, height=3.4)
    axes = panel_grid(figure, 1, len(angles), left=0.15, right=0.15, top=1.3, bottom=0.75, between=0.1)[0]
    view = view_from(np.deg2rad(-62), np.deg2rad(24))
    reach = 0.0
    for ax, angle in zip(axes, angles, strict=True):
        q = np.zeros(truth.nq)
        q[3], q[7:] = 1.0, angle
        everything = []
        for name, model in ((truth_name, truth), ("learned", learned)):
            color = INK if model is truth else LOOKS["learned"].color
            for b, (corners, _) in enumerate(posed(model, q)):
                own = model.corner_body == b
                edges = wireframe(truth.corner_pos[truth.corner_body == b]).edges
                flat = 1e3 * view(corners)
                everything.append(flat)
                width = 1.0 if model is truth else 1.6
                ax.add_collection(LineCollection(list(flat[edges]), colors=color, linewidths=width, label=name))
                if model is learned:
                    ax.plot(*flat[seen[own]].T, "o", ms=3.5, color=color, label="touched")
                    ax.plot(*flat[~seen[own]].T, "o", ms=3.5, mfc="white", color=color, label="unseen")
        points = np.concatenate(everything)
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        reach = max(reach, 0.55 * float(np.ptp(points, axis=0).max()))
        ax.set_aspect("equal", adjustable="box")
        ax.set_axis_off()
        ax.set_title(f"{np.rad2deg(angle):.0f}°", fontsize=9.5)
        ax.set_xlim(middle[0] - 1, middle[0] + 1)
        ax.set_ylim(middle[1] - 1, middle[1] + 1)
    for ax in axes:
        for get, put in ((ax.get_xlim, ax.set_xlim), (ax.get_ylim, ax.set_ylim)):
            center = float(np.mean(get()))
            put(center - reach, center + reach)
    learned_color = LOOKS["learned"].color
    entries = [
        (Line2D([], [], color=INK, lw=1.2), truth_name),
        (Line2D([], [], color=learned_color, lw=1.8), "learned"),
        (Line2D([], [], color=learned_color, marker="o", ls="none", ms=4), "touched the ground"),
        (Line2D([], [], color=learned_color, marker="o", mfc="white", ls="none", ms=4), "never did: not known"),
    ]
    key_row(figure, entries, y=0.72)
    footnote(figure, "Joint angle above each. To scale.")
    return figure
