"""Objects of several shapes, tossed with a tracker's noise, learned from nothing.

    python -m experiments.shapes OUT.jsonl --shapes ellipsoid "hexagonal prism" --engines lcp --seeds 1

Tosses pass through TUM files of poses in a frame that is off the shape's middle, as a tracker's is. A row compares what
is learned with the shape: the Hausdorff distance is over directions in which it came near the ground.
"""

from __future__ import annotations

import itertools
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

import tossid
from experiments.harness import Case, Line, markdown, measured, options, succeeded
from pipelines.cli.failures import guarded
from tossid.evaluation.metrics import score_tosses
from tossid.models import TrainedModel
from tossid.models.predictor import Simulator
from tossid.objects import ObjectModel, object_from_mjcf
from tossid.objects.roundness import directions, disc
from tossid.physics import make_system
from tossid.rotations import quat_to_matrix
from tossid.settings.objects import UnknownObjectSettings
from tossid.settings.synthesis import Engine, LcpEngine, MujocoEngine, NoiseSettings, ReleaseSettings
from tossid.store import Dataset, write_tum
from tossid.types import PoseTrack, Toss

Array = NDArray[np.float64]

MASS = 0.3
"""Of a shape [kg]."""
RATE_HZ, STEP = 148.0, 5e-5
"""Frames a second, and MuJoCo's time step [s], with which contact is near rigid: its time constant is twice that."""
NOISE = NoiseSettings(position=1.5e-4, rotation=2e-3)
"""Of tracked poses; of positions as of the published cube's."""
RELEASE = ReleaseSettings(height=(0.25, 0.25), speed=(0.0, 1.4), climb=(0.0, 1.0), spin=(4.0, 15.0), joint=(-3.1, 3.1))
FRAME_OFFSET = (0.012, -0.02, 0.007)
"""Where a shape's middle is in the recorded body frame [m]."""
CLOSE = 1e-3
"""What came so near the ground counts in the Hausdorff distance [m]."""
BESIDE_TRUTH = ("position [%]", "over the true model's", "rotation [deg]", "over the true's")
HEADS = (
    "found as", "corners", "Hausdorff [mm]", "seen [%]", "friction", "centre of mass [mm]", "inertia [%]",
    *BESIDE_TRUTH, "CPU s",
)  # fmt: skip


def _irregular() -> Array:
    """Twelve points, each a vertex that stands out from the hull of the others."""
    rng = np.random.default_rng(12)
    while True:
        points = np.array([0.055, 0.045, 0.04]) * directions(12) * rng.uniform(0.92, 1.12, (12, 1))
        if len(ConvexHull(points).vertices) == 12:
            return points


RING = np.array([[np.cos(angle), np.sin(angle)] for angle in np.linspace(0, 2 * np.pi, 6, endpoint=False)])
POLYTOPES = {
    "tetrahedron": 0.065 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3),
    "wedge": np.array([[x, y, z] for y in (-0.04, 0.04) for x, z in ((-0.05, -0.02), (0.05, -0.02), (-0.05, 0.04))]),
    "hexagonal prism": np.array([[*(0.045 * point), z] for z in (-0.03, 0.03) for point in RING]),
    "irregular polytope": _irregular(),
    "octahedron": np.array([0.05, 0.06, 0.045]) * np.concatenate([np.eye(3), -np.eye(3)]),
}
"""Vertices by name [m]."""
DISC, DISC_EDGE = 0.045, 0.01
"""Radius of the rounded disc, and of the ball at each of its points [m]."""
ROUND = {
    "ellipsoid": 'type="ellipsoid" size="0.06 0.045 0.035"',
    "rounded disc": f'type="cylinder" size="{DISC + DISC_EDGE} {DISC_EDGE}"',  # gets its edge afterwards
    "capsule": 'type="capsule" size="0.025 0.04"',
    "cylinder": 'type="cylinder" size="0.04 0.03"',
}
"""MJCF geoms by name."""
SHAPES = (*POLYTOPES, *ROUND)


def shape(name: str, *, friction: float = 0.25) -> ObjectModel:
    """A shape in its recorded frame.

    Args:
        name: Of `SHAPES`.
        friction: Coulomb's.
    """
    points = POLYTOPES.get(name)
    text = "" if points is None else " ".join(f"{value:.9g}" for value in points.ravel())
    model = object_from_mjcf(
        f"""<mujoco model="{name}">
  <asset>{f'<mesh name="m" inertia="exact" vertex="{text}"/>' if text else ""}</asset>
  <worldbody>
    <body name="{name}">
      <freejoint/>
      <geom name="hull" {ROUND.get(name, 'type="mesh" mesh="m"')} pos="{FRAME_OFFSET[0]} {FRAME_OFFSET[1]}
        {FRAME_OFFSET[2]}" mass="{MASS}"/>
    </body>
  </worldbody>
</mujoco>""",
        friction=friction,
    )
    if name != "rounded disc":
        return model
    rim = disc(DISC, [0.0, 0.0, 1.0], edge=DISC_EDGE)
    count = len(rim.radius)
    corners = {"corner_body": np.zeros(count, dtype=np.int64), "corner_pos": np.tile(FRAME_OFFSET, (count, 1))}
    return model.with_changes(roundness=rim, **corners)


def tossed(model: ObjectModel, engine: str, *, tosses: int = 60, seed: int = 0, step: float = STEP) -> Dataset:
    """Tosses from the air until an object rests, with a tracker's noise and their truth.

    Args:
        model: What is tossed.
        engine: mujoco, or tossid's own: lcp.
        tosses: How many.
        seed: Of all that is drawn.
        step: MuJoCo's time step [s].
    """
    exact = LcpEngine(substeps=16)
    how: Engine = exact if engine == "lcp" else MujocoEngine(substeps=round(1 / RATE_HZ / step))
    keys: dict[str, Any] = {"tosses": tosses, "seed": seed, "rate_hz": RATE_HZ, "release": RELEASE, "noise": NOISE}
    return tossid.synthesize(model, engine=how, **keys)


def learned_from_nothing(case: Case) -> Line:
    """What is learned of a shape, against the truth.

    Args:
        case: Its `shape`, `model`, `engine`, `seed`, friction `mu` and `step`.
    """
    true = shape(case["shape"], friction=case["mu"])
    made = tossed(true, case["engine"], seed=case["seed"], step=case["step"])
    assert made.truth is not None
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        write_tum(Path(folder), made.tosses)
        dataset = tossid.ingest(folder, source="tum", object="unknown")
    trained = tossid.train(dataset, model=case["model"], object=UnknownObjectSettings(mass=MASS))
    seconds, found = time.process_time() - began, trained.object
    true = replace(true, width=found.width)
    off, share = apart(found, true.hull_points(), made.truth.tosses)
    cells = [
        trained.parameters["from_nothing"]["shape"],
        f"{found.n_corners}",
        f"{1e3 * off:.2f}",
        f"{100 * share:.0f}",
        f"{found.friction:.3f}",
        f"{1e3 * np.linalg.norm(found.com[0] - true.com[0]):.2f}",
        f"{100 * np.linalg.norm(found.inertia[0] - true.inertia[0]) / np.linalg.norm(true.inertia[0]):.1f}",
        *beside_truth(trained, true, dataset.split("test")),
        f"{seconds:.0f}",
    ]
    return dict(zip(HEADS, cells, strict=True))


def beside_truth(trained: TrainedModel, true: ObjectModel, held_out: Dataset) -> list[str]:
    """Cells of how well rollouts predict tosses: position [% of a width] and rotation [deg], each over the truth's.

    Args:
        trained: The model.
        true: The object as it is, simulated by tossid.
        held_out: Tosses.
    """
    best = score_tosses(Simulator(make_system(true), substeps=4), true, held_out.tosses)
    ours = tossid.evaluate(trained, held_out).per_toss
    position, rotation = ours.position_error_pct.mean(), ours.rotation_error_deg.mean()
    return [
        f"{position:.1f}",
        f"{position / best.position_error_pct.mean():.2f}",
        f"{rotation:.1f}",
        f"{rotation / best.rotation_error_deg.mean():.2f}",
    ]


def apart(learned: ObjectModel, hull: Array, truth: Sequence[PoseTrack | Toss], body: int = 0) -> tuple[float, float]:
    """Hausdorff distance of two hulls, both ways, over directions in which the true one came near the ground.

    Of convex bodies it is the largest difference of their support functions.

    Args:
        learned: The learned object.
        hull: (n, 3) points of the true hull [m].
        truth: Motions of the body without noise.
        body: Of the learned object.

    Returns:
        The distance [m], and the share of all directions that is compared.
    """
    ways = directions(2000)
    down = np.concatenate([-quat_to_matrix(track.q[:, 3:7])[:, 2, :] for track in truth])
    height = np.concatenate([track.q[:, 2] for track in truth])
    reach = down @ hull.T
    near = height - reach.max(axis=1) < CLOSE
    seen = np.zeros(len(ways), dtype=bool)
    for part in np.array_split(down[near], max(1, int(near.sum()) // 500)):
        seen |= (ways @ part.T).max(axis=1) > np.cos(np.deg2rad(5))
    # what came near: the true points that touched, in all directions in which they are the farthest
    touched = np.flatnonzero((height[near, None] - reach[near] < CLOSE).any(axis=0))
    farthest = (ways @ hull.T).argmax(axis=1)
    seen |= np.isin(farthest, touched)
    difference = learned.support(ways, body).max(axis=1) - (ways @ hull.T).max(axis=1)
    return float(np.abs(difference[seen]).max()), float(seen.mean())


def main(arguments: list[str]) -> None:
    """Learn the shapes that OUT lacks, and print a row for each."""
    given = options(
        __doc__, arguments, out=Path, shapes=SHAPES, models=("cnrpi",), engines=("mujoco",), seeds=(0,), friction=0.25,
        step=STEP, processes=1,
    )  # fmt: skip
    names = ("shape", "model", "engine", "seed")
    asked = itertools.product(given.shapes, given.models, given.engines, given.seeds)
    beside = {"mu": given.friction, "step": given.step}
    cases = [{**dict(zip(names, values, strict=True)), **beside} for values in asked]
    lines = succeeded(measured(given.out, cases, learned_from_nothing, processes=given.processes))
    heads = (*names, *HEADS)
    print(markdown(heads, ([line[head] for head in heads] for line in lines)))


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(sys.argv[1:]), "shapes"))
