"""The demo's page: the film, the seal, what the change brings, and what was learned."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipelines.seal import Opened, Sealed, judgement
from tossid.objects import ObjectModel, load_object
from tossid.physics.effects import World, effect_named

if TYPE_CHECKING:
    from tossid.models import TrainedModel
    from tossid.store import Dataset
    from tossid.types import Rollout, Toss

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
    steps: list[tuple[str, float, float]],
) -> Path:
    """Write outputs/demo/index.html, with the pictures beside it.

    Args:
        seal: What was wrong, and what was found.
        gap: Of `tossid diagnose`.
        trained: Of `tossid train`.
        scores: Of `tossid evaluate`.
        steps: What each step took.
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
        steps=steps,
        dataset=DATASET,
        simulator=FOLDER / "cube.xml",
        pictures={path.stem: f"{pictures.name}/{path.name}" for path in sorted(pictures.iterdir())},
    )
    out = FOLDER / "index.html"
    out.write_text(text, encoding="utf-8")
    return out


STRIP = 6
"""Pictures of the film strip."""
FILM_STRIDE, FILM_MS = 2, 40
"""Every so many-th frame is in the film, and stays so long [ms]: a third of the true speed."""


def write_film(folder: Path) -> None:
    """Write the first toss as the first camera saw it, cut to where the cube is: film.gif, and strip_K.png.

    Args:
        folder: Where they go.
    """
    from PIL import Image

    from tossid.evaluation.figures import save_film
    from tossid.store import read_dataset
    from tossid.vision.recordings.formats.frames import read_recording

    recording, toss = read_recording(RECORDING), read_dataset(RECORDING / "truth.h5").tosses[0]
    frames = [
        np.asarray(Image.open(frame.path).convert("L"))
        for frame in recording.frames[recording.cameras[0].name]
        if toss.t[0] <= 1e-9 * frame.t_ns <= toss.t[-1]
    ]
    images = np.stack(frames)[:, *moving_part(np.stack(frames))]
    save_film(np.repeat(images[::FILM_STRIDE, ..., None], 3, axis=-1), folder / "film.gif", frame_ms=FILM_MS)
    for k, at in enumerate(np.linspace(0, len(images) - 1, STRIP).round().astype(int)):
        Image.fromarray(images[at]).save(folder / f"strip_{k}.png")


MOVED, ROOM = 40, 20
"""Grey levels by which a pixel changes that something moves through, and pixels that are left around these."""


def moving_part(images: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns of images (n, h, w) in which something moves."""
    moved = np.ptp(images, axis=0) > MOVED
    rows, columns = np.flatnonzero(moved.any(axis=1)), np.flatnonzero(moved.any(axis=0))
    return tuple(slice(max(0, each[0] - ROOM), each[-1] + ROOM) for each in (rows, columns))  # type: ignore[return-value]


def write_comparison(model: TrainedModel, patched: str | None, folder: Path) -> None:
    """Draw a toss that the learned model has not seen: as measured, and by cube.xml, by patched.xml, and as learned.

    It is the test toss that cube.xml predicts as well as half of them.

    Args:
        model: The learned model.
        patched: The patched file; None where nothing was found.
        folder: Where comparison.png goes.
    """
    from tossid.evaluation.figures import toss_comparison
    from tossid.store import read_dataset

    tosses = read_dataset(DATASET).split("test").tosses
    before = [in_mujoco(FOLDER / "cube.xml", toss) for toss in tosses]
    far = [
        np.linalg.norm(run.q[:, :3] - toss.q[:, :3], axis=1).mean() for run, toss in zip(before, tosses, strict=True)
    ]
    i = int(np.argsort(far)[len(far) // 2])
    rollouts = {"cube.xml": before[i]}
    if patched is not None:
        rollouts["patched.xml"] = in_mujoco(Path(patched), tosses[i])
    rollouts["cnrpi"] = learned(model, tosses[i])
    title = f"Toss {tosses[i].name}: in {', in '.join([*rollouts][:-1])}, and learned from nothing"
    toss_comparison(tosses[i], rollouts, load_object("cube"), title=title).savefig(folder / "comparison.png")


def in_mujoco(mjcf: Path, toss: Toss) -> Rollout:
    """A toss in a user's MuJoCo model, from what its free flight says of its start.

    Args:
        mjcf: The model.
        toss: As measured.
    """
    from tossid.diagnosis.likelihood.engine_discrepancy import MujocoWorld
    from tossid.diagnosis.likelihood.windows import make_windows
    from tossid.diagnosis.localisation.rollouts import at_frames, first_states
    from tossid.diagnosis.simulators import world_of_mjcf
    from tossid.objects.files.model_file import read_model_file
    from tossid.types import Rollout, frame_time

    world, _ = world_of_mjcf(mjcf, width=load_object("cube").width)
    simulated = MujocoWorld(read_model_file(mjcf).compiled(), world)
    (q,) = at_frames(
        [toss], first_states([toss], world, make_windows([toss], world.object)), frame_time([toss]), simulated.roll_out
    )
    return Rollout(toss.t, q, np.full_like(toss.v, np.nan), np.zeros((len(toss), 8)))


def learned(trained: TrainedModel, toss: Toss) -> Rollout:
    """A toss as a trained model predicts it, from what its free flight says of its start."""
    from tossid.evaluation.metrics import roll_out

    model = trained.model
    how: dict[str, Any] = {"measurement": model.measurement, "from_flight": True}
    return roll_out(model.simulator(), trained.object, [toss], **how)[0]


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
    rows: dict[str, tuple[float, str, Callable[[ObjectModel], Any]]] = {
        "extent [mm]": (1e3, ".1f", lambda cube: np.ptp(cube.drawn.corner_pos, axis=0)),
        "centre of mass [mm]": (1e3, ".1f", lambda cube: cube.com[0]),
        "inertia [kg cm²]": (1e4, ".2f", lambda cube: np.diag(cube.inertia[0])),
        "friction": (1.0, ".3f", lambda cube: [cube.friction]),
    }
    out = [
        [name, *(", ".join(f"{factor * x + 0.0:{digits}}" for x in of(cube)) for cube in both)]
        for name, (factor, digits, of) in rows.items()
    ]
    return [
        *out,
        ["error over whole tosses that it has not seen", f"{position:.1f} % of the width, {rotation:.1f}°", ""],
    ]
