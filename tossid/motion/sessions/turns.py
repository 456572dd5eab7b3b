"""Recordings that were turned about the vertical after they were tracked.

Publishers enlarge a dataset by turning recordings about the vertical, each by an angle of its own. What is constant in
the tracker's world, such as a tilt, then turns with the tosses: it looks like a law between place, velocity and
acceleration that is the same in all horizontal directions. If one side is thrown from, the direction of the throw shows
by how much a recording was turned, up to an angle that all share.

Whether recordings were turned is tested on the normals n of the faces that objects rest on, which know nothing of a
throw. With p the place of rest and R(theta) the turn to the direction of the throw,

    n = u + R(theta) c + (a + b J) p,    J a quarter turn:

u is the tilt of a world that was not turned, c that of one that was, and a and b are what a bent world (a lens) does
where tosses come from all sides. If all throws have one direction, u and c are the same and nothing is decided.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from tossid.motion.contact import lowest_corner
from tossid.motion.flight import first_parabola
from tossid.motion.sessions.levelling import KEPT, turned_track
from tossid.motion.sessions.witnesses import link_faces, resting_faces
from tossid.objects import ObjectModel
from tossid.robust import NORMAL_MAD, reweighted
from tossid.rotations import quat_exp, quat_mul
from tossid.types import OnDemand, PoseTrack, RecordingOrder

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

CLEAR_HEIGHT = 0.01
"""Height of the lowest corner above its lowest down to which a toss is taken to fly before its first contact [m]."""
FEWEST_FLIGHT, LEAST_SPEED = 4, 0.2
"""Frames of that flight, and horizontal speed [m/s], from which on it shows the direction of the throw."""
SAME_THROW = np.deg2rad(15.0)
"""A toss belongs to the recording of the one before if their directions differ by less [rad]."""
FEWEST_RECORDINGS = 12
"""Recordings from which on turns can be seen."""
SIGNIFICANCE = 0.001
"""Probability of taking recordings for turned that were not."""
LEAST_LEAN = np.deg2rad(0.1)
"""Least lean that turns with throws and matters [rad]."""
WORST_CONDITION = 1e3
"""Condition number from which on throws have too much one direction."""
OUTLIER, ITERATIONS = 2.5, 12
"""Standard deviations beyond which a toss counts no more than one at this distance; fits with such weights."""
LEAST_P = 1e-12
"""Least probability that is stated."""


class Lean(NamedTuple):
    """How resting faces lean [rad]: horizontal components of their normals.

    Attributes:
        world: The part that is fixed in the recorded world, u, (2,).
        throw: The part that is fixed in the axes of the throw: along it, and to its left, c, (2,).
        throw_cov: Its covariance over recordings, (2, 2).
    """

    world: Array
    throw: Array
    throw_cov: Array

    @property
    def p(self) -> float:
        """Probability of so large a part that turns with throws where there is none."""
        return float(chi2.sf(self.throw @ np.linalg.pinv(self.throw_cov) @ self.throw, 2))


@dataclass(frozen=True, eq=False)
class Turns:
    """The direction of each toss, and whether recordings were turned about the vertical.

    Attributes:
        names: Of the tosses, (n,).
        throws: Direction in which each was thrown, from the x axis [rad], (n,); NaN where it has no such flight.
        recording_of: Which recording each belongs to: tosses in a row that were thrown in one direction, (n,).
        yaw: Mean direction of the throws of each one's recording [rad], (n,); 0 where none shows it.
        lean: How resting faces lean; None where too few recordings show it, or where throws have one direction.
    """

    names: tuple[str, ...]
    throws: Array
    recording_of: Ints
    yaw: Array
    lean: Lean | None

    @property
    def were_turned(self) -> bool:
        """Whether recordings were turned."""
        lean = self.lean
        return lean is not None and lean.p < SIGNIFICANCE and float(np.linalg.norm(lean.throw)) > LEAST_LEAN

    def undone(self, tracks: Sequence[PoseTrack]) -> Sequence[PoseTrack]:
        """The tracks, each turned back so that all throws go along x.

        Args:
            tracks: As recorded.
        """
        back = self._back()
        return OnDemand(lambda i: turned_track(tracks[i], back[tracks[i].name], 0.0), len(tracks), kept=KEPT)

    def with_order(self, found: RecordingOrder) -> RecordingOrder:
        """What was found of the tracks of `undone`, with turns from the recorded ones.

        Args:
            found: Of the tracks that were turned back.
        """
        back = self._back()
        return replace(found, turn=quat_mul(found.turn, np.array([back[name] for name in found.names])))

    def _back(self) -> dict[str, Array]:
        return dict(zip(self.names, quat_exp(-self.yaw[:, None] * [0.0, 0.0, 1.0]), strict=True))


def find_turns(tracks: Sequence[PoseTrack], model: ObjectModel) -> Turns:
    """The directions of throws, and whether recordings were turned about the vertical.

    Objects without faces, or tosses that do not come to rest, decide nothing.

    Args:
        tracks: As recorded, z roughly up, in the order of recording.
        model: The object.
    """
    throws = np.array([throw_direction(track, model) for track in tracks])
    recording = _recordings(throws)
    known, yaw = np.isfinite(throws), np.full(len(tracks), np.nan)
    for k in np.unique(recording[known]):
        yaw[recording == k] = np.angle(np.exp(1j * throws[known & (recording == k)]).mean())
    faces = link_faces(model)
    resting = [resting_faces(track, model, faces)[:, :2] for track in tracks]
    has = np.isfinite(yaw) & np.array([len(own) > 0 for own in resting], dtype=bool)
    normals = np.array([resting[i].mean(axis=0) for i in np.flatnonzero(has)]).reshape(-1, 2)
    places = np.array([tracks[i].q[-1, :2] for i in np.flatnonzero(has).tolist()]).reshape(-1, 2)
    lean = find_lean(normals, places, yaw[has], recording[has])
    return Turns(tuple(track.name for track in tracks), throws, recording, np.nan_to_num(yaw), lean)


def throw_direction(track: PoseTrack, model: ObjectModel) -> float:
    """The direction in which an object flies before its first contact, from the x axis [rad]; NaN if too short or slow.

    Args:
        track: A toss as recorded.
        model: The object.
    """
    low = lowest_corner(model, track.q)
    flight = first_parabola(track.t, track.q[:, :3], low - low.min() > CLEAR_HEIGHT, FEWEST_FLIGHT)
    vx, vy = (0.0, 0.0) if flight is None else flight.coefficients[1, :2]
    return float(np.arctan2(vy, vx)) if np.hypot(vx, vy) > LEAST_SPEED else float("nan")


def _recordings(throws: Array) -> Ints:
    """Numbers of recordings (n,): a new one begins where the direction changes; a toss without one changes nothing."""
    known = np.flatnonzero(np.isfinite(throws))
    turned = np.angle(np.exp(1j * np.diff(throws[known])))
    begins = np.zeros(len(throws), np.int64)
    begins[known[1:]] = np.abs(turned) > SAME_THROW
    return np.cumsum(begins)


def find_lean(normals: Array, places: Array, yaw: Array, recording: Ints) -> Lean | None:
    """The parts u and c of n = u + R c + (a + b J) p, by robust least squares; their covariance is over recordings.

    Args:
        normals: n of each toss, horizontal components [rad], (n, 2).
        places: p, where it rests [m], (n, 2).
        yaw: Direction of the throws of its recording [rad], (n,).
        recording: Its recording, within which errors may be correlated, (n,).

    Returns:
        The parts; None where there are too few recordings, or where throws have one direction.
    """
    names = np.unique(recording)
    if len(names) < FEWEST_RECORDINGS:
        return None
    c, s, zero, one = np.cos(yaw), np.sin(yaw), np.zeros(len(yaw)), np.ones(len(yaw))
    x, y = places.T
    X = np.stack(
        [np.stack([one, zero, c, -s, x, -y], axis=1), np.stack([zero, one, s, c, y, x], axis=1)], axis=1
    )  # (n, 2, 6)
    scale = np.linalg.norm(X, axis=(0, 1))
    X = X / scale
    if np.linalg.cond(X.reshape(-1, 6)) > WORST_CONDITION:
        return None

    def fit(weights: Array) -> tuple[Array, Array]:
        root = np.sqrt(weights)
        z = np.linalg.lstsq((X * root[..., None]).reshape(-1, 6), (normals * root).ravel(), rcond=None)[0]
        off = np.abs(normals - X @ z)
        return z, off / (NORMAL_MAD * float(np.median(off)) + 1e-12)

    z, weights = reweighted(fit, normals.shape, limit=OUTLIER, iterations=ITERATIONS)
    bread = np.linalg.inv(np.einsum("nia,ni,nib->ab", X, weights, X))
    score = np.einsum("nia,ni->na", X, weights * (normals - X @ z))
    by_recording = np.array([score[recording == name].sum(axis=0) for name in names])
    k = len(names)
    cov = bread @ (by_recording.T @ by_recording) @ bread * (k / (k - 1)) / np.outer(scale, scale)
    z = z / scale
    return Lean(z[:2], z[2:4], cov[2:4, 2:4])


def turn_words(turns: Turns) -> str | None:
    """What was found of turns, in a sentence; None where recordings were not turned.

    Args:
        turns: Of a recording.
    """
    if not turns.were_turned or turns.lean is None:
        return None
    along, left = np.rad2deg(turns.lean.throw)
    return (
        f"{turns.recording_of.max() + 1} recordings were turned about the vertical after they were tracked: from "
        f"whichever side objects are thrown, resting faces lean by {along:.2f}° along the throw and {left:.2f}° to its "
        f"left (p < {max(turns.lean.p, LEAST_P):.1g})"
    )
