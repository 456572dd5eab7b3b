"""What accelerates the object over a toss: given dynamics, learned residual, contact."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator
from numpy.typing import NDArray

from tossid.evaluation.figures.style import (
    INK,
    LOOKS,
    MUTED,
    footnote,
    halo,
    label_ends,
    new_figure,
    number,
    panel_grid,
    styled,
)
from tossid.objects import GRAVITY

if TYPE_CHECKING:
    from tossid.evaluation.figures.accelerations import Accelerations

Array = NDArray[np.float64]

_CONTACT = "#D55E00"
_RESIDUAL = "#009E73"
_GIVEN = "#0072B2"
_LINEAR = 15.0
"""The contact panels are linear up to this [m/s²] and logarithmic beyond: impacts are tens of times gravity."""


@styled
def residual_over_toss(
    parts: Accelerations,
    *,
    title: str = "What accelerates the object",
    name: str = "",
) -> Figure:
    """Vertical accelerations over one toss (Bianchini and Posa 2023, Figure 2).

    Four series over a common time: the given continuous dynamics k_hat (gravity), the learned k_res, the contact
    impulses as (1/m) sum(lam_n) / dt, and the sum of the three against the measured acceleration, the difference of
    measured velocities over dt. In sustained contact the data determine only the sum of k_res and contact: there the
    series are hatched.

    Args:
        parts: Of `accelerations_over_toss`.
        title: The figure's title.
        name: The toss's name, for the subtitle.

    Returns:
        The figure.
    """
    t, given, residual, contact, measured = parts.t, parts.given, parts.residual, parts.contact, parts.measured
    total = given + residual + contact
    free = given + residual
    flown = np.cumprod(parts.separable & (np.abs(contact) < 1e-9)).astype(bool)
    subtitle = f"Toss {name}.  " if name else ""
    if flown.any():
        means = [number(float(np.mean(part[flown]))) for part in (given, free, measured)]
        subtitle += "Mean before first contact: given {}, with the learned part {}, measured {} m/s².".format(*means)
    figure = new_figure(title, subtitle, height=7.6)
    axes = panel_grid(
        figure, 4, 1, left=0.8, right=1.35, top=1.05, bottom=0.85, above=0.42, heights=[0.8, 0.8, 1.1, 1.3]
    )[:, 0]
    rows = (
        (axes[0], "Given continuous dynamics", "acceleration\n[m/s²]", [("given", given, _GIVEN, 1.8)]),
        (axes[1], "Learned acceleration", "acceleration\n[m/s²]", [("residual", residual, _RESIDUAL, 1.8)]),
        (axes[2], "Contact impulses / (m Δt)", "acceleration\n[m/s²], symlog", [("contact", contact, _CONTACT, 1.5)]),
        (
            axes[3], "Sum against measurement", "acceleration\n[m/s²], symlog",
            [("measured", measured, INK, 2.6), ("sum", total, LOOKS["cnrp"].color, 1.2)],
        ),
    )  # fmt: skip
    low, high = _limits([given, residual, -GRAVITY, -GRAVITY - given])
    border = np.concatenate([t[:1], 0.5 * (t[1:] + t[:-1]), t[-1:]])
    for i, (ax, heading, label, lines) in enumerate(rows):
        ax.set_title(heading)
        ax.set_ylabel(label)
        ax.set_xlim(t[0], t[-1])
        ax.axhline(0, color="#9aa0a8", lw=0.7, zorder=1, label="_zero")
        for key, values, color, width in lines:
            ax.plot(t, values, color=color, lw=width, label=key)
        if i < 2:
            ax.set_ylim(low, high)
        else:
            _symlog(ax, [values for _, values, _, _ in lines])
        _hatch(ax, border, parts.separable, beside=lines[0][1] if i in (1, 2) else None)
        label_ends(ax, [(t[-1], values[-1], key, color) for key, values, color, _ in lines])
        if i < 3:
            ax.tick_params(labelbottom=False)
    _level(axes[0], -GRAVITY, "true", f"true in flight: {number(-GRAVITY)}")
    missing = -GRAVITY - float(np.mean(given))
    _level(axes[1], missing, "missing", f"what is missing: {number(missing)}")
    axes[3].set_xlabel("time [s]")
    if not parts.separable.all():
        footnote(
            figure,
            "Hatched: sustained contact. There the data determine only the sum of learned acceleration and contact.",
        )
    return figure


def _level(ax: Axes, level: float, label: str, text: str) -> None:
    """A dashed line with its name over it, at the left."""
    ax.axhline(level, color=MUTED, ls="--", lw=1.1, label=label, zorder=2)
    name = ax.annotate(
        text, (0, level), (5, 3), xycoords=ax.get_yaxis_transform(), textcoords="offset points",
        fontsize=8.5, color=MUTED, va="bottom",
    )  # fmt: skip
    halo(name)


def _limits(values: Sequence[Array | float]) -> tuple[float, float]:
    """Common limits of the continuous parts, with zero inside."""
    flat = np.concatenate([np.ravel(v)[np.isfinite(np.ravel(v))] for v in values])
    low, high = min(0.0, float(flat.min())), max(0.0, float(flat.max()))
    room = 0.12 * (high - low) or 1.0
    return low - room, high + 1.6 * room


def _symlog(ax: Axes, values: list[Array]) -> None:
    """A symmetric logarithmic axis that holds impacts and free fall at once."""
    ax.set_yscale("symlog", linthresh=_LINEAR, linscale=1.0)
    flat = np.concatenate([v[np.isfinite(v)] for v in values])
    low, high = min(-_LINEAR, 1.5 * float(flat.min())), max(_LINEAR, 1.5 * float(flat.max()))
    ax.set_ylim(low, high)
    ticks = [s * v for v in (10, 100, 1000) for s in (-1, 1)]
    ax.set_yticks([0, *[v for v in ticks if low <= v <= high]])
    ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}".replace("-", "−"))
    ax.yaxis.set_minor_locator(NullLocator())


def _hatch(ax: Axes, border: Array, separable: NDArray[np.bool_], *, beside: Array | None) -> None:
    """Hatch the spans that are not separable; label the longest, away from the series `beside` (n,)."""
    starts = np.flatnonzero(np.diff(separable.astype(int), prepend=-1))
    spans = [(a, b) for a, b in zip(starts, [*starts[1:], len(separable)], strict=True) if not separable[a]]
    for a, b in spans:
        ax.axvspan(
            border[a], border[b], facecolor="#f1f2f4", edgecolor="#b9bec6", hatch="////", lw=0, zorder=0,
            label="not separable",
        )  # fmt: skip
    if not spans or beside is None:
        return
    a, b = max(spans, key=lambda span: float(border[span[1]] - border[span[0]]))
    to_axes = ax.transData + ax.transAxes.inverted()
    high = to_axes.transform((border[a], float(np.mean(beside[a:b]))))[1] > 0.5
    left, right = ax.get_xlim()
    center = min(max(0.5 * (border[a] + border[b]), left + 0.08 * (right - left)), right - 0.08 * (right - left))
    text = ax.text(
        center, 0.1 if high else 0.9, "not separable", transform=ax.get_xaxis_transform(), ha="center",
        va="bottom" if high else "top", fontsize=8.5, style="italic", color=MUTED,
    )  # fmt: skip
    halo(text)
