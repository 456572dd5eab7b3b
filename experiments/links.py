"""`make links`: an elbow, tossed with a tracker's noise or recorded, both links learned from nothing."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.shapes import apart, beside_truth, toss_options
from pipelines.cli.console import Console
from pipelines.cli.failures import guarded

if TYPE_CHECKING:
    from experiments.tossed_links import TossedLinks
    from experiments.tossed_shapes import ShapeTossSettings
    from tossid.models import TrainedModel
    from tossid.objects import ObjectModel
    from tossid.store import Dataset

SIMULATED = (
    "model",
    "engine, seed",
    "hinge: axis [deg]",
    "point [mm]",
    "corners",
    "Hausdorff [mm]",
    "seen [%]",
    "corners without contacts off by [mm]",
    "friction",
    "common centre of mass [mm]",
    "inertia [%]",
    "position [%]",
    "over the true model's",
    "rotation [deg]",
    "over the true model's",
    "seconds",
)
RECORDED = (
    "model",
    "start",
    "corners",
    "stated corners missed by at most [mm]",
    "corners with contacts off before training: median, most [mm]",
    "corners with contacts off by: median, most [mm]",
    "corners without contacts off by [mm]",
    "friction",
    "16 steps: position [%]",
    "first link [deg]",
    "second link [deg]",
    "joint [deg]",
    "gravity [m/s²]",
    "seconds",
)


def main(models: list[str], recorded: Path | None, settings: ShapeTossSettings) -> None:
    """Learn both links with each model; print a Markdown row for each.

    Args:
        models: Variants that learn.
        recorded: A dataset of a real elbow (.h5), whose stated object is the other start; None for simulated tosses.
        settings: How they are tossed.
    """
    console, head = Console(), SIMULATED if recorded is None else RECORDED
    console.say("| " + " | ".join(head) + " |")
    console.say("|" + "---|" * len(head))
    for cells in simulated(models, settings) if recorded is None else real(models, recorded):
        console.say("| " + " | ".join(cells) + " |")


def parsed(arguments: list[str]) -> tuple[list[str], Path | None, ShapeTossSettings]:
    """What the command's arguments ask for, as `main` takes it."""
    from experiments.tossed_shapes import ShapeTossSettings

    default = ShapeTossSettings(mass=0.37)
    parser = argparse.ArgumentParser(prog="make links", description=__doc__)
    parser.add_argument("models", nargs="*", default=["cn", "cnrpi"], metavar="MODEL")
    parser.add_argument("--recorded", type=Path, help="dataset of a real elbow (.h5), levelled by ingest")
    toss_options(parser, default)
    given = vars(parser.parse_args(arguments))
    models, recorded = given.pop("models"), given.pop("recorded")
    return models, recorded, replace(default, **given)


def simulated(models: list[str], settings: ShapeTossSettings) -> Any:
    """Rows of an elbow in an engine, from the TUM files of both links.

    Args:
        models: Variants that learn.
        settings: How it is tossed.

    Yields:
        A row a model.
    """
    import tossid
    from experiments.tossed_links import toss_links
    from tossid.settings.objects import UnknownObjectSettings
    from tossid.store.importers.tum import write_tum

    made, unknown = toss_links(settings), UnknownObjectSettings(links=2, mass=2 * settings.mass)
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        write_tum(Path(folder), made.first, second=made.second)
        dataset = tossid.ingest(folder, source="tum", object=unknown)
    ingested = time.process_time() - began
    for model in models:
        began = time.process_time()
        trained = tossid.train(dataset, model=model, object=unknown)
        seconds = ingested + time.process_time() - began
        yield [f"`{model}`", f"{settings.engine}, {settings.seed}", *_against(made, dataset, trained), f"{seconds:.0f}"]


def _against(made: TossedLinks, dataset: Dataset, trained: TrainedModel) -> list[str]:
    """Cells of what was learned against the truth."""
    import numpy as np

    from tossid.motion.links import determined, moments_of_com
    from tossid.physics.identifiable import inertia_error

    learned, (point, axis) = trained.object, made.hinge()
    true = replace(made.in_tracked_frames(dataset.object), width=learned.width)
    tilt = np.degrees(np.arccos(min(1.0, abs(axis @ learned.joint_axis[1]))))
    aside = 1e3 * np.linalg.norm(np.cross(learned.joint_pos[1] - point, axis))
    links = [
        apart(learned, true.corner_pos[true.corner_body == body], made.truth[body], body)
        for body in range(learned.n_bodies)
    ]
    shown = _shown(trained)
    off = 1e3 * _nearest(learned, true)
    parts = [moments_of_com(each, each.com, each.mass) for each in (learned, true)]
    com = 1e3 * np.linalg.norm(determined(true).T @ (parts[0] - parts[1]).ravel())
    return [
        f"{tilt:.3f}",
        f"{aside:.2f}",
        " + ".join(f"{int((learned.corner_body == body).sum())}" for body in range(learned.n_bodies)),
        ", ".join(f"{1e3 * distance:.2f}" for distance, _ in links),
        ", ".join(f"{100 * share:.0f}" for _, share in links),
        ", ".join(f"{x:.1f}" for x in off[~shown]) or "none",
        f"{learned.friction:.3f} for {true.friction:g}",
        f"{com:.2f}",
        f"{100 * inertia_error(learned, true):.1f}",
        *beside_truth(trained, true, dataset.split("test")),
    ]


def _shown(trained: TrainedModel) -> Any:
    """Marks corners (n_c,) that contacts have shown."""
    import numpy as np

    return np.concatenate([link["contacts"] for link in trained.parameters["from_nothing"]["links"]]) > 0


def _nearest(learned: ObjectModel, true: ObjectModel) -> Any:
    """Distance of each learned corner from the nearest true one of its link, (n_c,) [m]."""
    import numpy as np

    return np.array(
        [
            np.linalg.norm(true.corner_pos[true.corner_body == body] - corner, axis=1).min()
            for body, corner in zip(learned.corner_body, learned.corner_pos, strict=True)
        ]
    )


def real(models: list[str], path: Path) -> Any:
    """Rows of a recorded elbow, from the stated object and from nothing, on the same splits.

    Args:
        models: Variants that learn.
        path: The dataset.

    Yields:
        A row a model and start.
    """
    import numpy as np

    import tossid
    from tossid.evaluation.metrics import score_windows
    from tossid.settings.objects import UnknownObjectSettings
    from tossid.types import frame_time

    dataset = tossid.read_dataset(path)
    stated, held_out = dataset.object, dataset.split("test")
    unknown = UnknownObjectSettings(links=2, mass=float(stated.mass.sum()))
    for model in models:
        for start, object_ in (("stated", None), ("nothing", unknown)):
            began = time.process_time()
            trained = tossid.train(dataset, model=model, object=object_)
            seconds, learned = time.process_time() - began, trained.object
            shown = np.ones(learned.n_corners, dtype=bool)
            if object_ is not None:
                shown = _shown(trained)
            off, before = (1e3 * _nearest(each, stated) for each in (learned, trained.model.object))
            scores = score_windows(
                trained.model.simulator(),
                stated if object_ is None else learned.with_changes(width=stated.width),
                held_out.tosses,
                measurement=trained.model.measurement,
                dt=frame_time(held_out.tosses),
            )
            yield [
                f"`{model}`",
                start,
                " + ".join(f"{int((learned.corner_body == body).sum())}" for body in range(learned.n_bodies)),
                f"{1e3 * _nearest(stated, learned).max():.1f}",
                *(f"{np.median(x[shown]):.1f}, {x[shown].max():.1f}" for x in (before, off)),
                ", ".join(f"{x:.1f}" for x in off[~shown]) or "none",
                f"{learned.friction:.3f}",
                f"{np.nanmean(scores.position_error_pct):.2f}",
                *(f"{np.nanmean(scores.link_error_deg[:, body]):.2f}" for body in range(learned.n_bodies)),
                f"{np.nanmean(scores.joint_error_deg):.2f}",
                f"{np.nanmean(scores.gravity_ms2):.2f}",
                f"{seconds:.0f}",
            ]


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(*parsed(sys.argv[1:])), "links"))
