"""Scores by session, place, resting face and release: where what a model leaves lies.

A cause that a model does not have shows where tosses with it differ from those without. Groups are compared by the test
of Kruskal and Wallis (1952), which takes no distribution of scores for granted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import kruskal

from tossid.errors import InputError
from tossid.evaluation.metrics import summarize
from tossid.objects import ObjectModel, body_poses, corner_positions
from tossid.rotations import quat_to_matrix
from tossid.store import Dataset
from tossid.types import Toss

Array = NDArray[np.float64]
Labels = tuple[str, ...]

NONE = "none"
"""The group of tosses that do not have what they are grouped by."""


@dataclass(frozen=True)
class Group:
    """Tosses of one kind.

    Attributes:
        name: What they have in common.
        n: How many have a score.
        mean: Of their scores.
        ci95: Its 95 % interval over tosses.
    """

    name: str
    n: int
    mean: float
    ci95: tuple[float, float]


@dataclass(frozen=True)
class Comparison:
    """Scores of groups of tosses.

    Attributes:
        groups: In the order of their names, or of what they are grouped by.
        p: Probability of groups that differ as much, if they do not; NaN where there is one group only.
    """

    groups: tuple[Group, ...]
    p: float


def toss_groups(dataset: Dataset) -> dict[str, Labels]:
    """Groupings of a dataset's tosses: to which group each belongs.

    Numbers are cut at their terciles, places at their medians.

    Args:
        dataset: Its order of recording gives sessions and places.

    Returns:
        By grouping, a label a toss: "session", "place", "resting faces", "release face" (the first link's face that
        points down in the first frame), "release height", "release spin" and, with joints, "release joint".

    Raises:
        InputError: There are no tosses, or their order of recording was not looked at.
    """
    order, model, tosses = dataset.order, dataset.object, dataset.tosses
    if order is None or not len(tosses):
        raise InputError("there are no tosses, or their order of recording was not looked at; 'tossid ingest' does")
    at = {name: i for i, name in enumerate(order.names)}
    rows = np.array([at[toss.name] for toss in tosses])
    sessions = [f"{session.first} to {session.last}" for session in order.sessions]
    first = [toss.q[0] for toss in tosses]
    low = [float(corner_positions(model, q).min(axis=0)[2]) for q in first]
    found = {
        "session": tuple(sessions[k] for k in order.session_of[rows]),
        "place": _quadrants(order.places[rows]),
        "resting faces": tuple(_faces(model, toss.q[-1]) if _rests(toss) else NONE for toss in tosses),
        "release face": tuple(_faces(model, q).split(", ")[0] for q in first),
        "release height": _terciles(1e3 * np.array(low), "mm"),
        "release spin": _terciles(np.array([np.linalg.norm(toss.v[0, 3:6]) for toss in tosses]), "rad/s"),
    }
    if model.n_joints:
        # a joint's angle counts within half a turn, like its errors
        angles = np.array([q[7] for q in first])
        found["release joint"] = _terciles(np.rad2deg((angles + np.pi) % (2 * np.pi) - np.pi), "deg")
    return found


def compare_groups(scores: Array, labels: Sequence[str]) -> Comparison:
    """Scores by group, and whether groups differ by more than chance.

    Args:
        scores: One a toss (n,); NaN counts nowhere.
        labels: Of each toss's group.
    """
    known = np.isfinite(scores)
    by_name: Mapping[str, Array] = {
        name: scores[known & (np.array(labels) == name)] for name in sorted(set(labels), key=_natural)
    }
    groups = []
    for name, values in by_name.items():
        if len(values):
            summary = summarize(values)
            groups.append(Group(name, len(values), summary["mean"], tuple(summary["ci95"])))
    parts = [values for values in by_name.values() if len(values)]
    differ = len(parts) > 1 and np.ptp(np.concatenate(parts)) > 0
    return Comparison(tuple(groups), float(kruskal(*parts).pvalue) if differ else float("nan"))


def _natural(name: str) -> tuple[float, str]:
    """Numbers in their order, before words."""
    head = name.split(" ")[0]
    try:
        return float(head), name
    except ValueError:
        return float("inf"), name


def _terciles(values: Array, unit: str) -> Labels:
    edges = np.quantile(values, [0.0, 1 / 3, 2 / 3, 1.0])
    k = np.clip(np.searchsorted(edges[1:-1], values, side="right"), 0, 2)
    return tuple(f"{edges[i]:.3g} to {edges[i + 1]:.3g} {unit}" for i in k)


def _quadrants(places: Array) -> Labels:
    middle = np.median(places, axis=0)
    sides = [
        ("x < " if x < middle[0] else "x > ") + f"{middle[0]:.2f}, " + ("y < " if y < middle[1] else "y > ")
        for x, y in places
    ]
    return tuple(f"{side}{middle[1]:.2f} m" for side in sides)


def _rests(toss: Toss) -> bool:
    """Whether a toss's last frames hardly move: 1 mm and 0.02 rad in eight frames, as sessions have it."""
    last = toss.q[-8:]
    still = np.ptp(last[:, :3], axis=0).max() < 1e-3 and np.ptp(last[:, 7:], axis=0).max(initial=0.0) < 0.02
    return bool(len(last) == 8 and still)


def _faces(model: ObjectModel, q: Array) -> str:
    """The face of each link that points down, by the axis of its body that does: "-z, +x"."""
    down = [-quat_to_matrix(quat)[2] for quat in body_poses(model, q[None])[1][0]]
    axes = [int(np.argmax(np.abs(d))) for d in down]
    return ", ".join(("+" if d[k] > 0 else "-") + "xyz"[k] for d, k in zip(down, axes, strict=True))
