"""Where the real cube's law of flight comes from: the tables of docs/experiments/tracker.md.

python -m pipelines.tools.experiments.vision.tracker_law FOLDER [search]

FOLDER holds the published `contactnets_cube`. What is fitted to first flights is linear: each term is a force per mass,
integrated twice along the recorded motion, or a displacement of the recorded frame. Every toss has a free position and
velocity. Intervals are 95 % by bootstrap over recordings, that is over tosses in a row that were thrown in one
direction. With `search`, the library's effects of flight are selected, too, for tosses as published and turned back.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import tossid
from pipelines.cli.console import Console
from pipelines.cli.failures import guarded
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.inference.search import Search
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.motion.resting import rest_scatter
from tossid.motion.sessions.copies import find_copies
from tossid.motion.sessions.turns import InThrow, Turns, find_turns
from tossid.motion.sessions.witnesses import link_faces, resting_faces
from tossid.objects import ObjectModel, corner_heights, load_object
from tossid.physics.effects import World, effects_for
from tossid.rotations import quat_to_matrix
from tossid.store import drawn_splits
from tossid.store.importers import read_contactnets
from tossid.types import Phase, PoseTrack, Toss

Array = NDArray[np.float64]

CLEAR, FEWEST = 0.008, 12
"""Height of the lowest corner up to which a first flight goes [m], and frames that it has at least."""
BODY = ("gz", "com x", "com y", "com z")
MODELS: dict[str, tuple[str, ...]] = {
    "parabola": (),
    "drag": ("drag",),
    "law: turning and linear drag": ("J", "I", "v_z"),
    "law: position off by z (c I + d J) v": ("zI", "zJ"),
    "drag, turning": ("drag", "J"),
    "drag, tilt in the throw": ("drag", "g along", "g left"),
    "drag, tilt, turning": ("drag", "g along", "g left", "J"),
    "drag, tilt, bend to the left": ("drag", "g along", "g left", "bend left"),
    "drag, tilt, bend": ("drag", "g along", "g left", "bend along", "bend left"),
}
"""Terms beside gravity and the centre of mass. `tilt` and `bend` turn with the throw of the recording."""
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
FLAT = np.diag([1.0, 1.0, 0.0])
OUTLIER, STEPS, DRAWS = 2.5, 10, 400
SETS, TOSSES = 3, 40
"""Sets that effects are searched in, and tosses of each."""


@dataclass(frozen=True, eq=False)
class Flights:
    """First flights: times (k,), positions (k, 3), attitudes (k, 3, 3); the throw's direction; number of recording."""

    t: list[Array]
    p: list[Array]
    R: list[Array]
    yaw: Array
    recording: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.t)


@dataclass(frozen=True, eq=False)
class Fit:
    """Of a model to flights: values of its terms, draws of them (b, k), and what is left [m]."""

    terms: tuple[str, ...]
    values: Array
    draws: Array
    rms: float
    robust: float

    def __getitem__(self, term: str) -> float:
        return float(self.values[self.terms.index(term)])

    def interval(self, term: str) -> tuple[float, float]:
        """95 % of the draws."""
        low, high = np.percentile(self.draws[:, self.terms.index(term)], [2.5, 97.5])
        return float(low), float(high)


def first_flights(tracks: Sequence[PoseTrack], model: ObjectModel, turns: Turns, *, fewest: int = FEWEST) -> Flights:
    """The first flights of tosses that are long enough.

    Args:
        tracks: As recorded.
        model: The object.
        turns: Of the tracks: directions of throws, and recordings.
        fewest: Frames.
    """
    t, p, R, chosen = [], [], [], []
    for i, track in enumerate(tracks):
        low = corner_heights(model, track.q).min(axis=1)
        n = int(np.argmax(low < CLEAR)) if (low < CLEAR).any() else len(low)
        if n >= fewest and np.isfinite(turns.throws[i]):
            t.append(track.t[:n] - track.t[0])
            p.append(track.q[:n, :3])
            R.append(quat_to_matrix(track.q[:n, 3:7]))
            chosen.append(i)
    return Flights(t, p, R, turns.yaw[chosen], turns.recording_of[chosen])


def fit_flights(flights: Flights, terms: tuple[str, ...], *, draws: int = DRAWS, body: bool = True) -> Fit:
    """A model of flight, fitted robustly.

    Args:
        flights: What is fitted.
        terms: Of the model, beside gravity.
        draws: Of recordings, for intervals.
        body: Whether the centre of mass is off by a vector in the body.
    """
    own = (BODY if body else BODY[:1]) + terms
    made = [_columns(flights, i, own) for i in range(len(flights))]
    A, y = np.concatenate([a for a, _ in made]), np.concatenate([b for _, b in made])
    recording = np.concatenate([np.full(len(b), flights.recording[i]) for i, (_, b) in enumerate(made)])
    # (projected residuals have 2 of k degrees of freedom less on each axis)
    freedom = np.sqrt(sum(3 * (len(t) - 2) for t in flights.t) / len(y))
    size, w = np.linalg.norm(A, axis=0), np.ones(len(y))
    A = A / size
    for _ in range(STEPS):
        x, *_ = np.linalg.lstsq(A * w[:, None], y * w, rcond=None)
        r = y - A @ x
        scale = 1.4826 * float(np.median(np.abs(r))) + 1e-15
        w = np.sqrt(1 / np.maximum(1, np.abs(r) / (OUTLIER * scale)))
    numbers = np.unique(recording)
    normal = np.array([(A[recording == k] * w[recording == k, None] ** 2).T @ A[recording == k] for k in numbers])
    right = np.array([A[recording == k].T @ (w * w * y)[recording == k] for k in numbers])
    rng = np.random.default_rng(0)
    chosen = rng.integers(0, len(numbers), (draws, len(numbers)))
    drawn = np.array([np.linalg.solve(normal[pick].sum(axis=0), right[pick].sum(axis=0)) for pick in chosen])
    rms = float(np.sqrt(np.mean(r**2)))
    return Fit(own, x / size, drawn.reshape(draws, len(own)) / size, rms / freedom, scale / freedom)


def _columns(flights: Flights, i: int, terms: tuple[str, ...]) -> tuple[Array, Array]:
    """What each term adds to the positions of a flight (3 k, n) and those (3 k,), both less their straight lines."""
    t, p, R, yaw = flights.t[i], flights.p[i], flights.R[i], flights.yaw[i]
    middle = t - t.mean()
    basis = np.stack([np.ones(len(t)), middle, 0.5 * middle**2], axis=1)
    curve, *_ = np.linalg.lstsq(basis, p, rcond=None)
    v = curve[1] + curve[2] * middle[:, None]
    along, left = np.array([np.cos(yaw), np.sin(yaw), 0.0]), np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    way = (p @ along)[:, None] ** 2
    every = np.ones((len(t), 1))
    made = {
        "gz": lambda: _twice(every * [0.0, 0.0, 1.0], t),
        "drag": lambda: _twice(-np.linalg.norm(v, axis=1)[:, None] * v, t),
        "J": lambda: _twice(v @ QUARTER.T, t),
        "I": lambda: _twice(v @ FLAT, t),
        "v_z": lambda: _twice(v * [0.0, 0.0, 1.0], t),
        "zI": lambda: p[:, 2:] * (v @ FLAT),
        "zJ": lambda: p[:, 2:] * (v @ QUARTER.T),
        "g along": lambda: _twice(every * along, t),
        "g left": lambda: _twice(every * left, t),
        "bend along": lambda: way * along,
        "bend left": lambda: way * left,
        "com x": lambda: R[:, :, 0],
        "com y": lambda: R[:, :, 1],
        "com z": lambda: R[:, :, 2],
    }
    line = basis[:, :2]
    flat = np.eye(len(t)) - line @ np.linalg.pinv(line)
    A = np.stack([(flat @ made[term]()).ravel() for term in terms], axis=1)
    return A, (flat @ p).ravel()


def _twice(acceleration: Array, t: Array) -> Array:
    """The displacement that an acceleration (k, 3) makes, by trapezoids."""
    dt = np.diff(t)[:, None]
    v = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (acceleration[1:] + acceleration[:-1]) * dt, axis=0)])
    return np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (v[1:] + v[:-1]) * dt, axis=0)])


def resting_normals(tracks: Sequence[PoseTrack], model: ObjectModel) -> Array:
    """Horizontal components of the normals of faces at rest [rad], (n, 2); NaN where a toss does not end at rest."""
    faces, out = link_faces(model), np.full((len(tracks), 2), np.nan)
    for i, track in enumerate(tracks):
        found = resting_faces(track, model, faces)
        if len(found):
            out[i] = found[:, :2].mean(axis=0)
    return out


def _scatter(x: Array) -> float:
    """Robust scatter of the rows of (n, 2), of one component."""
    x = x[np.isfinite(x).all(axis=1)]
    return float(1.4826 * np.median(np.abs(x - np.median(x, axis=0))))


def _angles(fit: InThrow, unit: float) -> list[str]:
    sigma = np.sqrt(np.diag(fit.throw_cov))
    cells = [", ".join(f"{a:.2f}" for a in unit * fit.world)]
    cells.append(", ".join(f"{a:.2f} ± {s:.2f}" for a, s in zip(unit * fit.throw, unit * sigma, strict=True)))
    return [*cells, ", ".join(f"{a:.2f}" for a in unit * fit.slope)]


def main(data: Path, *, search: bool = False) -> None:
    """Say what is a copy, how resting faces lean, and what flights leave of each model."""
    console, model = Console(), load_object("cube")
    tracks = read_contactnets(data / "contactnets_cube")
    turns, copies = find_turns(tracks, model), find_copies(tracks)
    split = drawn_splits([track.name for track in tracks], seed=0)
    apart = sum(split[copy.name] != split[copy.of] for copy in copies)
    tested = sum("test" in (split[copy.name], split[copy.of]) and split[copy.name] != split[copy.of] for copy in copies)
    console.say(
        f"{len(tracks)} tosses in {turns.recording_of.max() + 1} recordings, {len(copies)} copies; drawn by name, "
        f"{apart} lie in another split than their original, {tested} of these pairs with one in the test split"
    )
    within = np.rad2deg(np.angle(np.exp(1j * (turns.throws - turns.yaw))))
    console.say(f"throws of a recording differ in direction by {np.std(within):.1f} degrees (standard deviation)")
    console.table(
        ("toss", "copy of", "turned by, degrees"), [[c.name, c.of, f"{np.rad2deg(c.yaw):.2f}"] for c in copies]
    )

    normals, places = resting_normals(tracks, model), np.array([track.q[-1, :2] for track in tracks])
    lean, c, s = turns.lean, np.cos(turns.yaw), np.sin(turns.yaw)
    if lean is not None:
        J = np.stack([-places[:, 1], places[:, 0]], axis=1)
        turned = np.stack([c * lean.throw[0] - s * lean.throw[1], s * lean.throw[0] + c * lean.throw[1]], axis=1)
        X = np.stack([places, J], axis=2)
        has = np.isfinite(normals).all(axis=1)
        slope, *_ = np.linalg.lstsq(X[has].reshape(-1, 2), normals[has].ravel(), rcond=None)
        console.table(
            ("fixed in the world, degrees", "in the throw: along, left, degrees", "with place: a, b, degrees/m"),
            [_angles(lean, 180 / np.pi)],
            title="normals of resting faces: n = u + R c + (a + b J) p",
        )
        left = [normals, normals - X @ slope, normals - turned]
        cells = [f"{np.rad2deg(_scatter(each)):.3f}" for each in left]
        console.table(("as recorded", "less (a + b J) p", "less R c"), [cells], title="scatter of normals, degrees")
        console.say(f"(a + b J) p alone: a = {np.rad2deg(slope[0]):.2f}, b = {np.rad2deg(slope[1]):.2f} degrees/m")

    flights = first_flights(tracks, model, turns)
    console.say(f"{len(flights)} first flights in {len(np.unique(flights.recording))} recordings")
    rows = []
    for name, terms in MODELS.items():
        fit = fit_flights(flights, terms)
        values = [f"{t} {fit[t]:.4f} ({fit.interval(t)[0]:.4f} to {fit.interval(t)[1]:.4f})" for t in ("gz", *terms)]
        rows.append([name, f"{1e3 * fit.rms:.4f}", f"{1e3 * fit.robust:.4f}", "; ".join(values)])
    console.table(("model", "rms, mm", "robust, mm", "values (95 %), SI"), rows)
    _say_speed(console, flights)
    if search:
        say_search(data, console)


def flight_effects(tosses: Sequence[Toss], model: ObjectModel) -> dict[str, tuple[float, ...]]:
    """The effects that a diagnosis selects in free flight alone, with their values [SI].

    Args:
        tosses: Of a dataset.
        model: Its object, and the simulator.
    """
    windows = make_windows(tosses, model, scatter=rest_scatter(tosses, model))
    flying = tuple(effect for effect in effects_for(model) if Phase.FLIGHT in effect.phases)
    search = Search(Sample(windows, len(tosses)).in_flight(), flying, Hypothesis(World(model)))
    hypothesis = search.run().hypothesis
    return {name: tuple(float(x) for x in hypothesis.values_of(name)) for name in hypothesis.names}


def say_search(data: Path, console: Console) -> None:
    """Say which effects of flight are selected on three disjoint sets of tosses, as published and turned back."""
    rows, folder = [], data / "contactnets_cube"
    for turned in ("keep", "undo"):
        made = tossid.ingest(folder, object="cube", turned=turned, progress=lambda progress: None)
        train = made.of_split("train")
        for first in range(0, SETS * TOSSES, TOSSES):
            found = flight_effects(train[first : first + TOSSES], made.object)
            words = "; ".join(f"{name} {', '.join(f'{x:.4g}' for x in values)}" for name, values in found.items())
            rows.append([turned, f"{first} to {first + TOSSES - 1}", words])
    console.table(("turned", "training tosses", "effects in flight, SI"), rows)


def _say_speed(console: Console, flights: Flights) -> None:
    """Whether sideways acceleration grows with speed, from fits to one flight at a time."""
    fit = fit_flights(flights, MODELS["drag, tilt in the throw"])
    values, speeds, sigma = np.zeros((len(flights), 2)), np.zeros((len(flights), 2)), np.zeros(len(flights))
    known = [term for term in fit.terms if not term.startswith("g ")]
    for i, t in enumerate(flights.t):
        A, y = _columns(flights, i, fit.terms)
        at = [fit.terms.index(term) for term in known if term != "gz"]
        free = [fit.terms.index(term) for term in ("gz", "g along", "g left")]
        rest = y - A[:, at] @ fit.values[at]
        x, *_ = np.linalg.lstsq(A[:, free], rest, rcond=None)
        values[i] = x[1:]
        off = float(np.sqrt(np.sum((rest - A[:, free] @ x) ** 2) / (3 * (len(t) - 3))))
        sigma[i] = np.hypot(off * np.sqrt(np.linalg.inv(A[:, free].T @ A[:, free])[2, 2]), 0.02)
        way = (flights.p[i][-1] - flights.p[i][0])[:2] / (t[-1] - t[0])
        yaw = flights.yaw[i]
        speeds[i] = [np.cos(yaw) * way[0] + np.sin(yaw) * way[1], -np.sin(yaw) * way[0] + np.cos(yaw) * way[1]]
    rows = []
    for name, y in (("along", values[:, 0]), ("left", values[:, 1])):
        x, cov = _clustered(np.stack([np.ones(len(y)), speeds[:, 0] - speeds[:, 0].mean()], axis=1), y, sigma, flights)
        law = x[0] / speeds[:, 0].mean()
        cells = [f"{a:.3f} ± {s:.3f}" for a, s in zip(x, np.sqrt(np.diag(cov)), strict=True)]
        rows.append([name, *cells, f"{law:.3f}"])
    console.table(
        (
            "acceleration",
            f"at {speeds[:, 0].mean():.3f} m/s, m/s²",
            "more for each m/s, 1/s",
            "in proportion to speed it would be",
        ),
        rows,
        title="horizontal acceleration of single flights in the axes of the throw, less drag and centre of mass",
    )


def _clustered(X: Array, y: Array, sigma: Array, flights: Flights) -> tuple[Array, Array]:
    """Robust weighted least squares with a covariance over recordings."""
    w = np.ones(len(y))
    for _ in range(STEPS):
        W = w / sigma
        x, *_ = np.linalg.lstsq(X * W[:, None], y * W, rcond=None)
        off = np.abs(y - X @ x) / sigma
        w = np.sqrt(1 / np.maximum(1, off / (OUTLIER * 1.4826 * np.median(off))))
    bread = np.linalg.inv((X * W[:, None]).T @ (X * W[:, None]))
    score = X * (W**2 * (y - X @ x))[:, None]
    meat = np.array([score[flights.recording == k].sum(axis=0) for k in np.unique(flights.recording)])
    return np.asarray(x, dtype=np.float64), np.asarray(bread @ (meat.T @ meat) @ bread)


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(Path(sys.argv[1]), search="search" in sys.argv[2:]), "tracker_law"))
