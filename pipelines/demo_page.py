"""The demo's page: the film, the seal, what the change brings, and what was learned."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipelines.drawing.toss_view import in_mujoco
from pipelines.seal import Opened, Sealed, judgement
from tossid.objects import ObjectModel, load_object
from tossid.physics.effects import World, effect_named
from tossid.types import Rollout

if TYPE_CHECKING:
    from tossid.models import TrainedModel
    from tossid.store import Dataset

RECORDING = Path("data/raw/demo")
DATASET = Path("data/datasets/demo.h5")
FOLDER = Path("outputs/demo")
"""Where the demo leaves its film, its dataset and its page."""
SHOWN = ("hull_over_tosses", "toss_median", "learned_geometry", "training_curves", "errors_along_rollout")
"""Pictures of the training and of the evaluation that the page shows."""


def write_page(
    seal: Opened,
    gap: dict[str, Any],
    trained: dict[str, Any],
    scores: dict[str, Any],
) -> Path:
    """Write outputs/demo/index.html, with the pictures beside it.

    Args:
        seal: What was wrong, and what was found.
        gap: Of `tossid diagnose`.
        trained: Of `tossid train`.
        scores: Of `tossid evaluate`.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    from pipelines.tracking.runs import find_run

    pictures = FOLDER / "pictures"
    shutil.rmtree(pictures, ignore_errors=True)
    pictures.mkdir()
    write_film(pictures)
    model = find_run(trained["run"]).trained_model()
    write_comparison(model, gap.get("patched_mjcf"), pictures)
    for path in map(Path, [*trained["figures"], *scores["figures"]]):
        if path.stem in SHOWN:
            shutil.copyfile(path, pictures / path.name)
    page = Environment(loader=PackageLoader("pipelines", "pages"), autoescape=True, undefined=StrictUndefined)
    text = page.get_template("demo.html.j2").render(
        seal=seal,
        judgement=judgement(seal),
        gap=gap,
        learned=learned_rows(model, seal.sealed, scores),
        poses=pose_rows(),
        dataset=DATASET,
        simulator=FOLDER / "cube.xml",
        pictures={path.stem: f"{pictures.name}/{path.name}" for path in sorted(pictures.iterdir())},
    )
    out = FOLDER / "index.html"
    out.write_text(text, encoding="utf-8")
    return out


FILM_STRIDE, FILM_MS = 2, 40
"""Every so many-th frame is in the film, and stays so long [ms]: a third of the true speed."""


def write_film(folder: Path) -> None:
    """Write the first toss as the first camera saw it: film.gif.

    Args:
        folder: Where they go.
    """
    from PIL import Image

    from tossid.evaluation.figures import save_film
    from tossid.store import read_dataset
    from tossid.vision.recordings.formats.frames import read_recording

    recording, toss = read_recording(RECORDING), read_dataset(RECORDING / "truth.h5").tosses[0]
    frames = [
        np.asarray(Image.open(frame.path).convert("RGB"))
        for frame in recording.frames[recording.cameras[0].name]
        if toss.t[0] <= 1e-9 * frame.t_ns <= toss.t[-1]
    ]
    save_film(np.stack(frames[::FILM_STRIDE]), folder / "film.gif", frame_ms=FILM_MS)


def write_comparison(trained: TrainedModel, patched: str | None, folder: Path) -> None:
    """Draw a toss that the learned model has not seen: as measured, and by cube.xml, by patched.xml, and as learned.

    It is the test toss that cube.xml predicts as well as half of them.

    Args:
        trained: The learned model.
        patched: The patched file; None where nothing was found.
        folder: Where comparison.png goes.
    """
    from tossid.diagnosis.localisation.rollouts import distances
    from tossid.evaluation.figures import toss_comparison
    from tossid.evaluation.metrics import roll_out
    from tossid.store import read_dataset

    cube, tosses = load_object("cube"), read_dataset(DATASET).split("test").tosses
    files = {"cube.xml": FOLDER / "cube.xml"} | ({} if patched is None else {"patched.xml": Path(patched)})
    motions = {name: in_mujoco(path, tosses, width=cube.width) for name, path in files.items()}
    far = distances(motions["cube.xml"], [toss.q for toss in tosses], cube.width)[:, 0]
    i = int(np.argsort(far)[len(far) // 2])
    toss = tosses[i]
    rollouts = {
        name: Rollout(toss.t, runs[i], np.full_like(toss.v, np.nan), np.zeros((len(toss), 8)))
        for name, runs in motions.items()
    }
    title = f"Toss {toss.name}: in {', in '.join(rollouts)}, and learned from nothing"
    model = trained.model
    how: dict[str, Any] = {"measurement": model.measurement, "from_flight": True}
    (rollouts["cnrpi"],) = roll_out(model.simulator(), trained.object, [toss], **how)
    toss_comparison(toss, rollouts, cube, title=title).savefig(folder / "comparison.png")


def pose_rows() -> list[list[str]]:
    """How many tosses were found, and how far their poses are from the truth."""
    from tossid.store import read_dataset

    truth, seen = read_dataset(RECORDING / "truth.h5"), read_dataset(DATASET)
    distance, turn = pose_errors(truth, seen)
    return [
        ["tosses found", f"{len(seen.tosses)} of {len(truth.tosses)}"],
        ["pose error, median", f"{np.median(distance):.3f} mm, {np.median(turn):.3f}°"],
        ["pose error, worst", f"{distance.max():.2f} mm, {turn.max():.2f}°"],
    ]


def pose_errors(truth: Dataset, seen: Dataset) -> tuple[Any, Any]:
    """Distance [mm] and angle [deg] between seen and true poses, in every frame of a seen toss that the truth has."""
    from tossid.rotations import geodesic_angle

    distance, angle = [], []
    for toss in seen.tosses:
        for true in truth.tosses:
            row = np.round((toss.t - true.t[0]) * truth.rate_hz).astype(int)
            inside = (row >= 0) & (row < len(true))
            distance.append(1e3 * np.linalg.norm(toss.q[inside, :3] - true.q[row[inside], :3], axis=1))
            angle.append(np.rad2deg(geodesic_angle(toss.q[inside, 3:7], true.q[row[inside], 3:7])))
    return np.concatenate(distance), np.concatenate(angle)


def learned_rows(trained: TrainedModel, sealed: Sealed, scores: dict[str, Any]) -> list[list[str]]:
    """What was learned of the cube beside what is true of it.

    Args:
        trained: The learned model.
        sealed: What the true cube has otherwise.
        scores: Of `tossid evaluate`.
    """
    effect = effect_named(sealed.effect)
    nominal = World(load_object("cube"))
    true = effect.at(nominal, effect.values_with(nominal, {sealed.parameter: sealed.value})).object
    both = (trained.model.learned_object(), true)
    position, rotation = (scores[key]["mean"] for key in ("position_error_pct", "rotation_error_deg"))

    def row(name: str, factor: float, digits: str, of: Callable[[ObjectModel], Any]) -> list[str]:
        return [name, *(", ".join(f"{factor * x + 0.0:{digits}}" for x in of(cube)) for cube in both)]

    return [
        row("extent [mm]", 1e3, ".1f", lambda cube: np.ptp(cube.drawn.corner_pos, axis=0)),
        row("centre of mass [mm]", 1e3, ".1f", lambda cube: cube.com[0]),
        row("inertia [kg cm²]", 1e4, ".2f", lambda cube: np.diag(cube.inertia[0])),
        row("friction", 1.0, ".3f", lambda cube: [cube.friction]),
        ["error over whole tosses that it has not seen", f"{position:.1f} % of the width, {rotation:.1f}°", ""],
    ]
