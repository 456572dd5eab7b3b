"""Training curves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tossid.errors import InputError
from tossid.evaluation.figures.style import (
    INK,
    LOOKS,
    MUTED,
    RULE,
    SPARE,
    footnote,
    halo,
    label_ends,
    new_figure,
    number,
    panel_grid,
    styled,
    wrapped,
)

if TYPE_CHECKING:
    from tossid.models import EpochRecord

PARTS = {
    "prediction": "#0072B2",
    "complementarity": "#D55E00",
    "dissipation": "#009E73",
    "penetration": "#C28E00",
    "residual": "#CC79A7",
}
"""Colours of the loss's parts."""
SUBTITLE = "Losses [m²/s²; rollouts: squared half widths and rad]; a ring: the lowest validation loss of a stage, kept"
DECADES = 7.0
"""Parts smaller than this many decades under the largest are drawn at the panel's foot, not to scale."""


LATE = 0.85
"""Share of the epochs from which on a stage that begins has no room for its name on its right."""


@styled
def training_curves(history: Sequence[EpochRecord], *, title: str = "Training") -> Figure:
    """Loss on training and validation tosses, and the training loss's parts, over epochs.

    Stages follow each other on the epoch axis and are marked; in each, the epoch of the lowest validation loss, whose
    parameters are kept, has a ring.

    Args:
        history: Records of the epochs, in order (N,).
        title: The figure's title.

    Raises:
        InputError: There are no epochs.
    """
    if not history:
        raise InputError("no epochs to draw")
    epoch = np.arange(1, len(history) + 1)
    train = np.array([record.train_loss for record in history])
    validation = np.array([record.validation_loss for record in history])
    unsolved = max(record.parts.get("unsolved", 0.0) for record in history)  # a count, and no part of the loss
    names = [name for name in dict.fromkeys(n for record in history for n in record.parts) if name != "unsolved"]
    starts = [i for i, record in enumerate(history) if i == 0 or record.stage != history[i - 1].stage]
    stages = [(history[a].stage, a, b) for a, b in zip(starts, [*starts[1:], len(history)], strict=True)]

    lowest = [(name, a + int(np.nanargmin(validation[a:b]))) for name, a, b in stages]
    note = f"Kept: {'; '.join(f'{name} {number(validation[k])} at epoch {k + 1}' for name, k in lowest)}."
    if unsolved:
        note += f" Unsolved inner problems: at most {unsolved:g} in an epoch."
    foot = 0.18 * wrapped(note).count("\n")
    figure = new_figure(title, SUBTITLE, height=6.2 + foot)
    margins = {"left": 1.0, "right": 1.55, "top": 0.98, "bottom": 0.85 + foot, "above": 0.5}
    upper, lower = panel_grid(figure, 2, 1, heights=[1.15, 1], **margins)[:, 0]
    blue = LOOKS["cnrp"].color
    for (_, first, last), (_, k) in zip(stages, lowest, strict=True):
        upper.plot(epoch[first:last], train[first:last], color=INK, marker=".", label="training")
        upper.plot(epoch[first:last], validation[first:last], color=blue, marker=".", label="validation")
        upper.plot(epoch[k], validation[k], "o", ms=10, mfc="none", mec=blue, label="_kept")
    _log_limits(upper, np.concatenate([train, validation]), decades=np.inf)

    spare = (color for color, _ in SPARE)
    colors = {name: PARTS.get(name) or next(spare, MUTED) for name in names}
    curves = {name: np.array([record.parts.get(name, np.nan) for record in history]) for name in names}
    _log_limits(lower, np.concatenate(list(curves.values())) if curves else np.ones(1), decades=DECADES)
    floor = lower.get_ylim()[0]
    for name, values in curves.items():
        drawn = np.where(np.isfinite(values), np.maximum(values, floor), np.nan)
        for _, first, last in stages:
            lower.plot(epoch[first:last], drawn[first:last], color=colors[name], marker=".", label=name)

    upper.set(title="Loss", ylabel="loss [stage's unit]")
    lower.set(title="Parts of the training loss", ylabel="part of the loss [stage's unit]", xlabel="epoch [count]")
    upper.tick_params(labelbottom=False)
    for ax in (upper, lower):
        ax.set_xlim(0.5, len(history) + 0.5)
        ax.xaxis.set_major_locator(MaxNLocator(8, integer=True, min_n_ticks=1))
        for i, (name, first, last) in enumerate(stages):
            if i % 2:
                ax.axvspan(first + 0.5, last + 0.5, color="#f3f5f8", lw=0, zorder=0)
            if i:
                ax.axvline(first + 0.5, color=RULE, lw=0.8, zorder=1)
            if ax is upper and len(stages) > 1:
                form: dict[str, Any] = {"transform": ax.get_xaxis_transform(), "va": "top", "style": "italic"}
                late = first > LATE * len(history)  # its name goes to the left of the axes' end
                x, side = (len(history) + 0.5, "right") if late else (first + 0.5, "left")
                halo(ax.text(x, 0.985 - 0.085 * (i % 2), f" {name} ", ha=side, **form)).set_color(MUTED)
    label_ends(upper, [(epoch[-1], train[-1], "training", INK), (epoch[-1], validation[-1], "validation", blue)])
    lasts = {name: values[np.isfinite(values)][-1] for name, values in curves.items()}
    label_ends(
        lower,
        [
            (epoch[-1], max(last, floor), name if last > floor else f"{name} (≈ 0)", colors[name])
            for name, last in lasts.items()
        ],
    )
    footnote(figure, note)
    return figure


def _log_limits(ax: Any, values: np.ndarray, *, decades: float) -> None:
    """A log axis over the positive values, at most so many decades of them; linear where there are none."""
    positive = values[np.isfinite(values) & (values > 0)]
    if not len(positive):
        return
    high = positive.max()
    low = max(positive.min(), high * 10.0**-decades)
    room = max(0.06 * np.log10(high / low), 0.05)
    ax.set_yscale("log")
    ax.set_ylim(low * 10**-room, high * 10 ** (2.2 * room))
