"""Tosses that are copies of earlier ones.

Publishers enlarge a dataset by turning tosses about the vertical. A copy holds no news, and one in the test split of a
toss in the train split is no test. So a copy goes to the split of its first (`tossid.store.drawn_splits`). Two tracks
of one motion cannot agree to a micrometre, for their noise differs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.rotations import quat_exp, quat_to_matrix
from tossid.types import SPLITS, PoseTrack, Toss

Array = NDArray[np.float64]

SAME_PLACE = 1e-6
"""Greatest distance of a copy's positions [m]; noise is at least ten times as much."""
SAME_ANGLE = 1e-5
"""Greatest difference of its attitudes, and of its joints [rad, m]."""
NAMED = 4
"""Copies that a sentence names."""


@dataclass(frozen=True)
class Copy:
    """Two tosses that are the same one.

    Attributes:
        of: Name of the earlier toss.
        name: Name of the later one.
        yaw: By which the later one is turned about the vertical against the earlier one [rad].
    """

    of: str
    name: str
    yaw: float


def find_copies(tracks: Sequence[PoseTrack | Toss]) -> tuple[Copy, ...]:
    """Tosses that are earlier ones turned about the vertical, shifted, or with the body's axes named otherwise.

    Args:
        tracks: As recorded, or as a dataset has them.

    Returns:
        Each later toss with the first that it equals, in the order of the tosses.
    """
    # copies have as many frames and the same range of heights, to within the width of a bin
    originals: dict[tuple[int, int], list[int]] = {}
    out = []
    for i, track in enumerate(tracks):
        frames, at = len(track.t), round(float(np.ptp(track.q[:, 2])) / SAME_PLACE)
        for j in (j for near in (at - 1, at, at + 1) for j in originals.get((frames, near), ())):
            yaw = _yaw_between(tracks[j], track)
            if yaw is not None:
                out.append(Copy(tracks[j].name, track.name, yaw))
                break
        else:
            originals.setdefault((frames, at), []).append(i)
    return tuple(out)


def _yaw_between(first: PoseTrack | Toss, second: PoseTrack | Toss) -> float | None:
    """By how much the second is turned against the first [rad]; None where they are different tosses."""
    a, b = (track.q[:, :3] - track.q[:, :3].mean(axis=0) for track in (first, second))
    cross, dot = float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])), float(np.sum(a[:, :2] * b[:, :2]))
    yaw = float(np.arctan2(cross, dot))
    turn = quat_to_matrix(quat_exp(np.array([0.0, 0.0, yaw])))
    if np.abs(a @ turn.T - b).max() > SAME_PLACE:
        return None
    between = (turn @ quat_to_matrix(first.q[:, 3:7])).mT @ quat_to_matrix(second.q[:, 3:7])
    same = np.abs(between - between[0]).max() < SAME_ANGLE
    return yaw if same and np.allclose(first.q[:, 7:], second.q[:, 7:], atol=SAME_ANGLE) else None


def copy_words(copies: Sequence[Copy]) -> str | None:
    """What was found of copies, in a sentence; None where there are none.

    Args:
        copies: Of a recording.
    """
    if not copies:
        return None
    pairs = ", ".join(f"{copy.name} of {copy.of} ({np.rad2deg(copy.yaw):.1f}°)" for copy in copies[:NAMED])
    more = f" and {len(copies) - NAMED} more" if len(copies) > NAMED else ""
    noun = "toss is a copy of an earlier one" if len(copies) == 1 else "tosses are copies of earlier ones"
    return f"{len(copies)} {noun}, turned about the vertical: {pairs}{more}"


def leak_words(tosses: Sequence[Toss]) -> str | None:
    """What a dataset's splits leak by copies, in a line; None where they leak nothing.

    A toss leaks that equals one of an earlier split, from which a model was learned or chosen.

    Args:
        tosses: All tosses of a dataset.
    """
    split = {toss.name: toss.split for toss in tosses}
    groups: dict[str, list[str]] = {}
    for copy in find_copies(tosses):
        groups.setdefault(copy.of, [copy.of]).append(copy.name)
    leaks = dict.fromkeys(SPLITS, 0)
    for group in groups.values():
        drawn = sorted(SPLITS.index(split[name]) for name in group if split[name])
        for place in drawn:
            leaks[SPLITS[place]] += place > drawn[0]
    if not any(leaks.values()):
        return None
    test, validation = (f"{leaks[name]} of {list(split.values()).count(name)}" for name in ("test", "validation"))
    return (
        f"copies leak between splits: {test} test tosses equal one of train or validation, and {validation} validation "
        "tosses one of train, turned about the vertical; ingest anew to have copies in one split"
    )
