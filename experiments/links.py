"""Two links on a hinge, tossed with a tracker's noise or recorded, both learned from nothing.

    python -m experiments.links OUT.jsonl --models cn cnrpi --engines lcp
    python -m experiments.links OUT.jsonl --recorded pll_elbow.h5

Each link is tracked in a frame of its own. The other start of a recorded elbow (a dataset that `ingest` has levelled)
is its stated object.
"""

from __future__ import annotations

import itertools
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import tossid
from experiments.harness import Case, Line, markdown, measured, options, succeeded
from experiments.shapes import BESIDE_TRUTH, NOISE, apart, beside_truth, tossed
from pipelines.cli.failures import guarded
from tossid.evaluation.metrics import score_windows
from tossid.models import TrainedModel
from tossid.motion.links import body_tracks, determined, moments_of_com
from tossid.objects import ObjectModel, object_from_mjcf
from tossid.physics.identifiable import inertia_error
from tossid.rotations import quat_conj, quat_exp, quat_mul, quat_rotate, quat_to_matrix
from tossid.settings.objects import UnknownObjectSettings
from tossid.store import write_tum
from tossid.types import PoseTrack, frame_time

Array = NDArray[np.float64]

MASS, FRICTION = 0.37, 0.25
"""Of each link [kg], and of both."""
ELBOW = f"""<mujoco model="elbow">
  <worldbody>
    <body name="elbow_1">
      <freejoint/>
      <geom name="first" type="box" size="0.05 0.025 0.025" mass="{MASS}"/>
      <body name="elbow_2" pos="-0.035 0.06 0">
        <joint name="hinge" type="hinge" axis="0 1 0"/>
        <geom name="second" type="box" size="0.05 0.025 0.025" pos="0.035 0 0" mass="{MASS}"/>
      </body>
    </body>
  </worldbody>
</mujoco>"""
"""As published with dair_pll, of solid boxes."""
FRAMES = (
    (np.array([0.012, -0.02, 0.007]), quat_exp(np.array([0.4, -0.7, 0.2]))),
    (np.array([-0.01, 0.006, 0.02]), quat_exp(np.zeros(3))),
)
"""Where a tracker's frame is in each link: origin [m], quaternion."""
SIMULATED = (
    "hinge: axis [deg]", "point [mm]", "corners", "Hausdorff [mm]", "seen [%]", "corners without contacts off by [mm]",
    "friction", "common centre of mass [mm]", "inertia [%]", *BESIDE_TRUTH, "CPU s",
)  # fmt: skip
RECORDED = (
    "corners", "stated corners missed by at most [mm]", "corners with contacts off by: median, most [mm]",
    "corners without contacts off by [mm]", "friction", "16 steps: position [%]", "first link [deg]",
    "second link [deg]", "joint [deg]", "gravity [m/s²]", "CPU s",
)  # fmt: skip


class TossedLinks(NamedTuple):
    """Two links that were tossed, with their truth.

    Attributes:
        tracks: Tracked poses of each link, with noise.
        truth: The same without noise.
        object: The elbow that was tossed.
    """

    tracks: tuple[tuple[PoseTrack, ...], ...]
    truth: tuple[tuple[PoseTrack, ...], ...]
    object: ObjectModel

    def hinge(self) -> tuple[Array, Array]:
        """The true hinge in link 2's tracked frame: a point of the axis [m], and the axis."""
        origin, quat = FRAMES[1]
        back = quat_conj(quat)
        return quat_rotate(back, -origin), quat_rotate(back, self.object.joint_axis[1])

    def in_tracked_frames(self, hinged: ObjectModel) -> ObjectModel:
        """The true object in the tracked frames, over the hinge that a dataset has.

        Args:
            hinged: The dataset's object, for its hinge alone.
        """
        turn = np.array([quat_to_matrix(quat_conj(quat)) for _, quat in FRAMES])
        at, own = np.array([origin for origin, _ in FRAMES]), self.object
        bodies = own.corner_body
        return hinged.with_changes(
            mass=own.mass,
            com=np.einsum("bij,bj->bi", turn, own.com - at),
            inertia=turn @ own.inertia @ turn.transpose(0, 2, 1),
            corner_body=bodies,
            corner_pos=np.einsum("nij,nj->ni", turn[bodies], own.corner_pos - at[bodies]),
            friction=own.friction,
            width=own.width,
        )


def toss_links(engine: str, *, seed: int = 0, tosses: int = 60) -> TossedLinks:
    """Tosses of an elbow, each link tracked in a frame of its own.

    Args:
        engine: What simulates.
        seed: Of all that is drawn.
        tosses: How many.
    """
    model, rng = object_from_mjcf(ELBOW, friction=FRICTION, width=0.1), np.random.default_rng([seed, 1])
    made = tossed(model, engine, tosses=tosses, seed=seed).truth
    assert made is not None
    exact = tuple(
        tuple(_seen_from(track, *frame) for track in tracks)
        for tracks, frame in zip(body_tracks(model, made.tosses), FRAMES, strict=True)
    )
    return TossedLinks(tuple(tuple(_noisy(track, rng) for track in tracks) for tracks in exact), exact, model)


def _seen_from(track: PoseTrack, origin: Array, turn: Array) -> PoseTrack:
    """The track of a frame that is fixed in a link."""
    place = track.q[:, :3] + quat_rotate(track.q[:, 3:7], origin)
    return PoseTrack(track.name, track.t, np.concatenate([place, quat_mul(track.q[:, 3:7], turn)], axis=1))


def _noisy(track: PoseTrack, rng: np.random.Generator) -> PoseTrack:
    q = track.q.copy()
    q[:, :3] += NOISE.position * rng.normal(size=(len(q), 3))
    q[:, 3:7] = quat_mul(q[:, 3:7], quat_exp(NOISE.rotation * rng.normal(size=(len(q), 3))))
    return PoseTrack(track.name, track.t, q)


def simulated(case: Case) -> Line:
    """What is learned of an elbow in an engine, from the TUM files of both links, against the truth.

    Args:
        case: Its `model`, `engine` and `seed`.
    """
    made, unknown = toss_links(case["engine"], seed=case["seed"]), UnknownObjectSettings(links=2, mass=2 * MASS)
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        write_tum(Path(folder), made.tracks[0], second=made.tracks[1])
        dataset = tossid.ingest(folder, source="tum", object=unknown)
    trained = tossid.train(dataset, model=case["model"], object=unknown)
    seconds = time.process_time() - began
    learned, (point, axis) = trained.object, made.hinge()
    true = replace(made.in_tracked_frames(dataset.object), width=learned.width)
    tilt = np.degrees(np.arccos(min(1.0, abs(axis @ learned.joint_axis[1]))))
    aside = 1e3 * np.linalg.norm(np.cross(learned.joint_pos[1] - point, axis))
    links = [
        apart(learned, true.corner_pos[true.corner_body == body], made.truth[body], body)
        for body in range(learned.n_bodies)
    ]
    off = 1e3 * nearest(learned, true)
    parts = [moments_of_com(each, each.com, each.mass) for each in (learned, true)]
    com = 1e3 * np.linalg.norm(determined(true).T @ (parts[0] - parts[1]).ravel())
    cells = [
        f"{tilt:.3f}",
        f"{aside:.2f}",
        _counts(learned),
        ", ".join(f"{1e3 * distance:.2f}" for distance, _ in links),
        ", ".join(f"{100 * share:.0f}" for _, share in links),
        ", ".join(f"{x:.1f}" for x in off[~with_contacts(trained)]) or "none",
        f"{learned.friction:.3f}",
        f"{com:.2f}",
        f"{100 * inertia_error(learned, true):.1f}",
        *beside_truth(trained, true, dataset.split("test")),
        f"{seconds:.0f}",
    ]
    return dict(zip(SIMULATED, cells, strict=True))


def recorded(case: Case, path: Path) -> Line:
    """What is learned of a recorded elbow, against its stated object.

    Args:
        case: Its `model` and `start`: the stated object, or nothing.
        path: The dataset.
    """
    dataset = tossid.read_dataset(path)
    stated, held_out, nothing = dataset.object, dataset.split("test"), case["start"] == "nothing"
    unknown = UnknownObjectSettings(links=2, mass=float(stated.mass.sum())) if nothing else None
    began = time.process_time()
    trained = tossid.train(dataset, model=case["model"], object=unknown)
    seconds, learned = time.process_time() - began, trained.object
    shown = with_contacts(trained) if nothing else np.ones(learned.n_corners, dtype=bool)
    off = 1e3 * nearest(learned, stated)
    scores = score_windows(
        trained.model.simulator(),
        learned.with_changes(width=stated.width) if nothing else stated,
        held_out.tosses,
        measurement=trained.model.measurement,
        dt=frame_time(held_out.tosses),
    )
    cells = [
        _counts(learned),
        f"{1e3 * nearest(stated, learned).max():.1f}",
        f"{np.median(off[shown]):.1f}, {off[shown].max():.1f}",
        ", ".join(f"{x:.1f}" for x in off[~shown]) or "none",
        f"{learned.friction:.3f}",
        f"{np.nanmean(scores.position_error_pct):.2f}",
        *(f"{np.nanmean(scores.link_error_deg[:, body]):.2f}" for body in range(learned.n_bodies)),
        f"{np.nanmean(scores.joint_error_deg):.2f}",
        f"{np.nanmean(scores.gravity_ms2):.2f}",
        f"{seconds:.0f}",
    ]
    return dict(zip(RECORDED, cells, strict=True))


def _counts(model: ObjectModel) -> str:
    return " + ".join(str(int((model.corner_body == body).sum())) for body in range(model.n_bodies))


def with_contacts(trained: TrainedModel) -> NDArray[np.bool_]:
    """Marks corners (n_c,) that contacts have shown."""
    return np.concatenate([link["contacts"] for link in trained.parameters["from_nothing"]["links"]]) > 0


def nearest(learned: ObjectModel, true: ObjectModel) -> Array:
    """Distance of each learned corner from the nearest true one of its link, (n_c,) [m]."""
    return np.array(
        [
            np.linalg.norm(true.corner_pos[true.corner_body == body] - corner, axis=1).min()
            for body, corner in zip(learned.corner_body, learned.corner_pos, strict=True)
        ]
    )


def main(arguments: list[str]) -> None:
    """Learn both links as often as OUT lacks it, and print a row for each."""
    given = options(
        __doc__, arguments, out=Path, models=("cn", "cnrpi"), engines=("mujoco",), seeds=(0,), recorded="", processes=1
    )
    names: tuple[str, ...] = ("model", "engine", "seed")
    asked: Sequence[tuple[object, ...]] = [*itertools.product(given.models, given.engines, given.seeds)]
    measure: Callable[[Case], Line] = simulated
    heads: tuple[str, ...] = SIMULATED
    if given.recorded:
        names, asked = ("model", "start"), [*itertools.product(given.models, ("stated", "nothing"))]
        measure, heads = partial(recorded, path=Path(given.recorded)), RECORDED
    cases = [dict(zip(names, values, strict=True)) for values in asked]
    lines = succeeded(measured(given.out, cases, measure, processes=given.processes))
    print(markdown((*names, *heads), ([line[head] for head in (*names, *heads)] for line in lines)))


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(sys.argv[1:]), "links"))
