"""Which errors of a tracker leave the real cube's law: the second table of docs/experiments/tracker.md.

python -m pipelines.tools.experiments.vision.tracker_errors FOLDER

FOLDER holds the published `contactnets_cube`. Its first flights and resting poses, made exactly ballistic and exactly
flat, are seen by three cameras around the table with one error at a time. Poses are estimated as TagSLAM does it for a
body in view of fixed cameras: least squares over the corners of all visible tags in all cameras, with one weight for
every pixel. No noise is added, so what a law leaves of the flights is what the error itself scatters. The publication
does not describe the cameras: three at an elevation of 38 degrees, 1.2 m away, with 430 px a metre there.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipelines.cli.console import Console
from pipelines.cli.failures import guarded
from pipelines.tools.experiments.vision.tracker_law import Flights, first_flights, fit_flights
from tossid.motion.sessions.turns import Turns, find_turns, in_throw
from tossid.objects import ObjectModel, load_object
from tossid.rotations import quat_exp, quat_to_matrix
from tossid.store.importers import read_contactnets
from tossid.types import PoseTrack

Array = NDArray[np.float64]

GRAVITY, HALF = 9.81, 0.0524
DISTANCE, ELEVATION, FOCAL, CENTRE = 1.2, np.deg2rad(38.0), 516.0, np.array([640.0, 512.0])
AZIMUTHS = np.deg2rad([60.0, 180.0, 300.0])
"""Of the cameras, from the direction of the throw where all throws have one."""
TAG = 0.8
"""Width of a tag over that of its face."""
SEEN = 0.3
"""Least cosine between a face's normal and the line of sight."""
STEPS = 5


@dataclass(frozen=True, eq=False)
class Scene:
    """Poses and motion of frames: positions (n, 3), attitudes (n, 3, 3), velocities and spins in the world (n, 3)."""

    p: Array
    R: Array
    v: Array
    w: Array

    def at(self, delay: Array | float) -> Scene:
        """The poses so much later [s], (n,) or one."""
        later = np.broadcast_to(delay, len(self.p))[:, None]
        fall = np.array([0.0, 0.0, -0.5 * GRAVITY]) * later**2 * (np.abs(self.v[:, :1]) > 0)
        return Scene(self.p + self.v * later + fall, quat_to_matrix(quat_exp(self.w * later)) @ self.R, self.v, self.w)


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole with one radial term; `R` takes the world's axes to right, down, forward."""

    at: Array
    R: Array
    focal: float = FOCAL
    centre: Array = field(default_factory=lambda: CENTRE)
    k1: float = 0.0

    def pixels(self, X: Array) -> Array:
        """Of points in the world (…, 3)."""
        local = (X - self.at) @ self.R.T
        flat = local[..., :2] / local[..., 2:]
        return self.focal * flat * (1 + self.k1 * np.sum(flat**2, axis=-1, keepdims=True)) + self.centre


@dataclass(frozen=True, eq=False)
class Error:
    """What is wrong: with cameras, with the time at which one sees a pixel, with tags and corners, or behind it all."""

    says: str
    camera: Callable[[int, Camera], Camera] = lambda number, camera: camera
    delay: Callable[[int, Array], Array | float] = lambda number, pixels: 0.0
    corners: Callable[[Array], Array] = lambda corners: corners
    pixels: Callable[[Array], Array] = lambda pixels: pixels
    behind: Callable[[Scene, Array], Array] = lambda scene, p: p


def _nominal(azimuth: float) -> Camera:
    away = np.array([np.cos(azimuth) * np.cos(ELEVATION), np.sin(azimuth) * np.cos(ELEVATION), np.sin(ELEVATION)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return Camera(DISTANCE * away + [0.0, 0.0, 0.1], np.stack([right, np.cross(-away, right), -away]))


def _turned(camera: Camera, *turn: float) -> Camera:
    """Turned about its own axes [degrees]."""
    return Camera(
        camera.at,
        quat_to_matrix(quat_exp(np.deg2rad(np.array(turn)))) @ camera.R,
        camera.focal,
        camera.centre,
        camera.k1,
    )


def _moved_world(camera: Camera, tilt: Array) -> Camera:
    """Seen from a world that is tilted [degrees]."""
    turn = quat_to_matrix(quat_exp(np.deg2rad(tilt)))
    return Camera(turn.T @ camera.at, camera.R @ turn, camera.focal, camera.centre, camera.k1)


def _one(change: Callable[[Camera], Camera], number: int = 0) -> Callable[[int, Camera], Camera]:
    return lambda i, camera: change(camera) if i == number else camera


def _raised_tag(corners: Array) -> Array:
    out = corners.copy()
    out[0] += [1e-3, 0.0, 0.0]
    return out


def _shrunk(pixels: Array) -> Array:
    """Corners (n, 6, 4, 2) 0.3 px nearer to their tag's centre."""
    away = pixels - pixels.mean(axis=2, keepdims=True)
    return np.asarray(pixels - 0.3 * away / np.linalg.norm(away, axis=-1, keepdims=True))


ERRORS = (
    Error("world tilted by 0.5°", camera=lambda i, c: _moved_world(c, np.array([0.5, -0.15, 0.0]))),
    Error("one camera turned by 0.1° about its right", camera=_one(lambda c: _turned(c, 0.1, 0, 0))),
    Error("one camera turned by 0.1° about its down", camera=_one(lambda c: _turned(c, 0, 0.1, 0))),
    Error("one camera rolled by 0.3°", camera=_one(lambda c: _turned(c, 0, 0, 0.3))),
    Error("all cameras rolled by 0.3°", camera=lambda i, c: _turned(c, 0, 0, 0.3)),
    Error("one camera 5 mm off to its right", camera=_one(lambda c: Camera(c.at + 5e-3 * c.R[0], c.R))),
    Error("all focal lengths off by 1 %", camera=lambda i, c: Camera(c.at, c.R, 1.01 * c.focal)),
    Error("one focal length off by 1 %", camera=_one(lambda c: Camera(c.at, c.R, 1.01 * c.focal))),
    Error(
        "one principal point off by 5 px",
        camera=_one(lambda c: Camera(c.at, c.R, FOCAL, CENTRE + np.array([5.0, 0.0]))),
    ),
    Error("radial distortion of 0.05 in all", camera=lambda i, c: Camera(c.at, c.R, k1=0.05)),
    Error("radial distortion of 0.05 in one", camera=_one(lambda c: Camera(c.at, c.R, k1=0.05))),
    Error("one clock late by 2 ms", delay=lambda i, px: 2e-3 if i == 0 else 0.0),
    Error("rolling shutter, 13 µs a line, down", delay=lambda i, px: 13e-6 * px[:, 1]),
    Error("rolling shutter, 13 µs a line, to the right", delay=lambda i, px: 13e-6 * px[:, 0]),
    Error("one tag 1 mm above its face", corners=_raised_tag),
    Error("corners 0.3 px towards their tag's centre", pixels=_shrunk),
    Error("low pass of 5 ms behind", behind=lambda scene, p: p - 5e-3 * scene.v),
)


def _corners() -> Array:
    """Tag corners by face, (6, 4, 3); faces +x, -x, +y, -y, +z, -z."""
    square = TAG * HALF * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    faces = []
    for axis in range(3):
        for side in (HALF, -HALF):
            face = np.zeros((4, 3))
            face[:, axis] = side
            face[:, (axis + 1) % 3], face[:, (axis + 2) % 3] = square.T
            faces.append(face)
    return np.array(faces)


def _placed(scene: Scene, corners: Array) -> Array:
    """Corners in the world, (n, 6, 4, 3)."""
    return np.einsum("nij,fcj->nfci", scene.R, corners) + scene.p[:, None, None]


def tracked(scene: Scene, error: Error) -> tuple[Array, Array]:
    """Positions (n, 3) and attitudes (n, 3, 3) as a tracker with an error has them."""
    cameras, corners = [_nominal(azimuth) for azimuth in AZIMUTHS], _corners()
    normals = np.einsum("nij,fj->nfi", scene.R, corners.mean(axis=1) / HALF)
    measured, weight = [], []
    for i, camera in enumerate(cameras):
        true = error.camera(i, camera)
        late = scene.at(error.delay(i, camera.pixels(scene.p)))
        measured.append(error.pixels(true.pixels(_placed(late, error.corners(corners)))))
        sight = camera.at - _placed(scene, corners).mean(axis=2)
        sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
        weight.append(np.sum(normals * sight, axis=-1) > SEEN)
    p, R = scene.p.copy(), scene.R.copy()
    for _ in range(STEPS):
        JJ, Jr = np.zeros((len(p), 6, 6)), np.zeros((len(p), 6))
        for camera, pixels, seen in zip(cameras, measured, weight, strict=True):
            arms = np.einsum("nij,fcj->nfci", R, corners)
            local = (arms + p[:, None, None] - camera.at) @ camera.R.T
            x, y, z = np.moveaxis(local, -1, 0)
            zero = np.zeros_like(x)
            along = camera.focal * np.stack(
                [np.stack([1 / z, zero, -x / z**2], axis=-1), np.stack([zero, 1 / z, -y / z**2], axis=-1)], axis=-2
            )
            J = along @ camera.R  # by a shift in the world
            by_turn = np.cross(arms[..., None, :], J)
            J = np.concatenate([J, by_turn], axis=-1) * seen[:, :, None, None, None]
            r = (pixels - camera.pixels(arms + p[:, None, None])) * seen[:, :, None, None]
            JJ += np.einsum("nfcia,nfcib->nab", J, J)
            Jr += np.einsum("nfcia,nfci->na", J, r)
        step = np.linalg.solve(JJ, Jr[..., None])[..., 0]
        p = p + step[:, :3]
        R = quat_to_matrix(quat_exp(step[:, 3:])) @ R
    return error.behind(scene, p), R


def _motions(flights: Flights) -> Scene:
    """All frames of flights, made ballistic with their own spin."""
    p, R, v, w = [], [], [], []
    for t, at, turn in zip(flights.t, flights.p, flights.R, strict=True):
        middle = t - t.mean()
        fall = np.array([0.0, 0.0, -GRAVITY])
        line = np.polyfit(middle, at - 0.5 * fall * middle[:, None] ** 2, 1)
        p.append(line[1] + line[0] * middle[:, None] + 0.5 * fall * middle[:, None] ** 2)
        v.append(line[0] + fall * middle[:, None])
        step = np.array([turn[k + 1] @ turn[k].T for k in range(len(t) - 1)])
        skew = step - step.swapaxes(1, 2)
        axis = 0.5 * np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1).mean(axis=0) / np.diff(t).mean()
        R.append(turn)
        w.append(np.broadcast_to(axis, (len(t), 3)))
    return Scene(*(np.concatenate(each) for each in (p, R, v, w)))


def _rests(tracks: list[PoseTrack]) -> tuple[Scene, NDArray[np.int64]]:
    """Last poses, made exactly flat; and which axis of the body is up."""
    p = np.array([track.q[-1, :3] for track in tracks])
    R = quat_to_matrix(np.array([track.q[-1, 3:7] for track in tracks]))
    up = np.abs(R[:, 2]).argmax(axis=1)
    normal = R[np.arange(len(R)), :, up] * np.sign(R[np.arange(len(R)), 2, up])[:, None]
    axis = np.cross(normal, [0.0, 0.0, 1.0])
    size = np.linalg.norm(axis, axis=1, keepdims=True)
    turn = quat_to_matrix(quat_exp(axis / np.maximum(size, 1e-12) * np.arcsin(size)))
    return Scene(p, turn @ R, 0 * p, 0 * p), up


@dataclass(frozen=True, eq=False)
class Signs:
    """What an error leaves: at rest in the throw [rad] and with place [rad/m], and of flights."""

    lean: Array
    slope: Array
    tilt: Array
    law: Array
    left: float


def signs(tracks: list[PoseTrack], model: ObjectModel, turns: Turns, error: Error) -> Signs:
    """The signatures of an error for tosses as these.

    Args:
        tracks: The tosses.
        model: The cube.
        turns: Directions of their throws.
        error: Of the tracker.
    """
    flights, (rest, up) = first_flights(tracks, model, turns), _rests(tracks)
    at, turned = tracked(rest, error)
    normal = turned[np.arange(len(up)), :, up] * np.sign(turned[np.arange(len(up)), 2, up])[:, None]
    yaw = turns.yaw if turns.recording_of.max() else np.zeros(len(up))
    lean = in_throw(normal[:, :2], at[:, :2], yaw, turns.recording_of)
    edges = np.cumsum([len(t) for t in flights.t])[:-1]
    p, R = tracked(_motions(flights), error)
    seen = Flights(flights.t, np.split(p, edges), np.split(R, edges), flights.yaw, flights.recording)
    law = fit_flights(seen, ("J", "I", "v_z"), body=False, draws=2)
    tilt = fit_flights(seen, ("g along", "g left"), body=False, draws=2)
    if lean is None:  # all throws have one direction
        mean, slope = np.median(normal[:, :2], axis=0), np.full(2, np.nan)
    else:
        mean, slope = lean.throw, lean.slope
    up_of_fall = -np.array([tilt["g along"], tilt["g left"]]) / GRAVITY
    return Signs(mean, slope, up_of_fall, np.array([law["J"], law["I"], law["v_z"]]), law.rms)


def main(data: Path) -> None:
    """Say what each error leaves, for throws from all sides and for throws from one side."""
    console, model = Console(), load_object("cube")
    tracks = list(read_contactnets(data / "contactnets_cube"))
    turns = find_turns(tracks, model)
    back = list(turns.undone(tracks))
    one_side = Turns(turns.names, turns.throws - turns.yaw, turns.recording_of, 0 * turns.yaw, None, False)
    for title, own, directions in (("from all sides", tracks, turns), ("from one side", back, one_side)):
        rows = []
        for error in ERRORS:
            found = signs(own, model, directions, error)
            lean, slope, tilt = (np.rad2deg(x) for x in (found.lean, found.slope, found.tilt))
            J, I, z = found.law
            size = 0.12 / abs(J) if abs(J) > 1e-4 else np.inf
            cells = [f"{x[0]:.3f}, {x[1]:.3f}" for x in (lean, slope, tilt)]
            left = [f"{1e3 * found.left:.4f}", f"{size:.1f}", f"{1e3 * found.left * size:.3f}"]
            rows.append([error.says, *cells, f"{J:.4f}, {I:.4f}, {z:.4f}", *left])
        head = ("error", "rest, degrees", "with place, degrees/m", "fall, degrees", "J, I, v_z, 1/s")
        more = ("left by the law, mm", "times for J = 0.12", "left then, mm")
        console.table((*head, *more), rows, title=f"throws {title}")


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(Path(sys.argv[1])), "tracker_errors"))
