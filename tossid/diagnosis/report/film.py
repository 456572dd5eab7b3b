"""The toss that is predicted worst: a film that a browser plays without a script (SVG), and stills for paper."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from tossid.diagnosis.result import Diagnosis
from tossid.evaluation.figures.wireframe import View, Wireframe, posed, view_from, wireframes
from tossid.objects import ObjectModel

Array = NDArray[np.float64]

ELEVATION = np.deg2rad(18)
SLOWER = 3.0
"""How much slower than the toss its film is."""
HOLD = 1.5
"""Seconds for which the film's last picture stays."""
MOST_FRAMES = 60
STILLS = 6
MOST_EDGES = 40
"""Of a body whose edges are drawn; a round body, which has more of them, is its outline."""
NOTHING = "M0 0"
"""A path that draws nothing."""
WIDTH = 960
"""Of a picture in its own units."""
FLATTEST, TALLEST = 0.28, 0.62
"""Least and largest height of a picture over its width."""
BEYOND = 0.5
"""How far beyond the measured motion a picture reaches at most, over its extent: a prediction may leave it."""
GRID = 0.1
"""Distance of the ground's lines [m]."""


@dataclass(frozen=True)
class Panel:
    """A prediction of a toss over what was measured.

    Attributes:
        label: "before" or "after" the changes.
        position_mm: Mean position error of this toss [mm].
        moving: The film, an SVG element.
        stills: Pictures side by side at equal times, an SVG element.
    """

    label: str
    position_mm: float
    moving: str
    stills: str


def worst_toss(diagnosis: Diagnosis) -> list[Panel]:
    """The worst toss before the changes and, where there are any, after them; empty if every rollout diverged.

    Args:
        diagnosis: What was found.
    """
    worst = diagnosis.brings.worst
    if worst is None:
        return []
    predicted = {"before": worst.before, **({"after": worst.after} if diagnosis.change else {})}
    frames = np.unique(np.linspace(0, len(worst.t) - 1, min(len(worst.t), MOST_FRAMES)).round().astype(int))
    motions = {"measured": worst.measured, **predicted}
    stage = _Stage.of(diagnosis.hypothesis.base.object, motions)
    times = np.rint(1000 * worst.t[frames] / (worst.t[-1] + HOLD / SLOWER)) / 1000
    timing = (
        f'dur="{SLOWER * worst.t[-1] + HOLD:.1f}s" repeatCount="indefinite" calcMode="discrete" '
        f'keyTimes="{";".join(f"{x:g}" for x in times)}"'
    )
    stills = frames[np.linspace(0, len(frames) - 1, STILLS).round().astype(int)]
    panels = []
    for label, q in predicted.items():
        off = 1e3 * float(np.linalg.norm(q[:, :3] - worst.measured[:, :3], axis=1).mean())
        words = f"Toss {worst.name}: the object as measured and as predicted {label} the changes."
        both = {"measured": worst.measured, label: q}
        moving = stage.svg(stage.picture(both, frames, timing), words, 1)
        row = "".join(
            f'<svg x="{k * WIDTH}" width="{WIDTH}" height="{stage.height}">{stage.picture(both, [frame])}</svg>'
            for k, frame in enumerate(stills)
        )
        panels.append(Panel(label, off, moving, stage.svg(row, words, STILLS)))
    return panels


@dataclass(frozen=True)
class _Stage:
    """What all pictures of a toss share.

    Attributes:
        model: The object.
        wires: Edges of each of its bodies.
        view: From where it is seen.
        place: From points (..., 3) [m] to places in a picture (..., 2).
        height: Of a picture.
        ground: Path of the ground's lines.
    """

    model: ObjectModel
    wires: tuple[Wireframe, ...]
    view: View
    place: Callable[[Array], Array]
    height: int
    ground: str

    @staticmethod
    def of(model: ObjectModel, motions: dict[str, Array]) -> _Stage:
        """A stage that has room for the measured motion, seen across the direction in which it goes."""
        way = motions["measured"][-1, :2] - motions["measured"][0, :2]
        view = view_from(np.arctan2(way[1], way[0]) - np.pi / 2, ELEVATION)
        points = {name: np.concatenate([_corners(model, each) for each in q]) for name, q in motions.items()}
        low, high = _extent(points["measured"], view)
        ends = np.array([_extent(each, view) for each in points.values()])
        reach = BEYOND * (high - low)
        low, high = np.maximum(ends[:, 0].min(0), low - reach), np.minimum(ends[:, 1].max(0), high + reach)
        width, tall = (high - low) * 1.06
        height = int(WIDTH * np.clip(tall / width, FLATTEST, TALLEST))
        scale, middle = min(WIDTH / width, height / tall), (low + high) / 2

        def place(x: Array) -> Array:
            return (view(x) - middle) * [scale, -scale] + np.array([WIDTH, height]) / 2

        return _Stage(model, tuple(wireframes(model)), view, place, height, _ground(points["measured"], place))

    def picture(self, motions: dict[str, Array], frames: Sequence[int] | NDArray[np.int64], timing: str = "") -> str:
        """The ground, the paths of the object's frame, and its bodies at some frames, one after the other.

        Args:
            motions: Poses by the class of style with which they are drawn.
            frames: Their frames.
            timing: Attributes of the animation, if there are several frames.
        """
        out = f'<path class="ground" d="{self.ground}"/>'
        for name, q in motions.items():
            out += f'<path class="{name} way" d="{_path(self.place(q[:, :3]))}"/>'
        for name, q in motions.items():
            drawn = [self._bodies(q[frame]) for frame in frames]
            for part, values in zip(("body", "far", "near"), zip(*drawn, strict=True), strict=True):
                moves = f'<animate attributeName="d" {timing} values="{";".join(values)}"/>' if timing else ""
                out += f'<path class="{name} {part}" d="{values[0]}">{moves}</path>'
        return out

    def svg(self, inside: str, words: str, columns: int) -> str:
        """An SVG element as wide as some pictures."""
        box = f"0 0 {columns * WIDTH} {self.height}"
        return f'<svg viewBox="{box}" role="img" aria-label="{escape(words)}">{inside}</svg>'

    def _bodies(self, q: Array) -> tuple[str, str, str]:
        """Paths of the outlines of all bodies, and of their edges on the far and on the near side."""
        outline, far, near = "", "", ""
        for (corners, quat), wires in zip(posed(self.model, q), self.wires, strict=True):
            flat = self.place(corners)
            outline += _path(flat[ConvexHull(flat).vertices]) + "z"
            if len(wires.edges) <= MOST_EDGES:
                front = wires.visible(quat, self.view.toward)
                near += "".join(_path(flat[edge]) for edge in wires.edges[front])
                far += "".join(_path(flat[edge]) for edge in wires.edges[~front])
        return outline, far or NOTHING, near or NOTHING


def _corners(model: ObjectModel, q: Array) -> Array:
    return np.concatenate([corners for corners, _ in posed(model, q)])


def _extent(points: Array, view: View) -> tuple[Array, Array]:
    """The corners of the rectangle of the view (2,) that has points (n, 3) and what is below them on the ground."""
    flat = view(np.concatenate([points, points * [1, 1, 0]]))
    return flat.min(axis=0), flat.max(axis=0)


def _ground(points: Array, place: Callable[[Array], Array]) -> str:
    """Lines on z = 0 below points (n, 3)."""
    low, high = (GRID * end for end in (np.floor(points.min(0) / GRID) - 1, np.ceil(points.max(0) / GRID) + 1))
    path = ""
    for axis in (0, 1):
        for at in np.arange(low[axis], high[axis] + 1e-9, GRID):
            line = np.zeros((2, 3))
            line[:, axis], line[:, 1 - axis] = at, (low[1 - axis], high[1 - axis])
            path += _path(place(line))
    return path


def _path(points: Array) -> str:
    """SVG's path through points (n, 2)."""
    return "M" + " ".join(f"{x:.0f} {y:.0f}" for x, y in points)
