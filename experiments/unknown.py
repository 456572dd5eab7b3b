"""`make unknown`: models of the published cube from its stated object and from nothing, side by side."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from pipelines.cli.console import Console
from pipelines.cli.failures import guarded

TOSSES = (64, 16, 8)
MODELS = ("cn", "cnrpi")


def main(folder: Path) -> None:
    """Train each model from each start on so many tosses; print a Markdown row for each.

    Args:
        folder: Holds contactnets_cube.
    """
    import numpy as np

    import tossid
    from tossid.settings.objects import UnknownObjectSettings

    console, dataset = Console(), tossid.ingest(folder / "contactnets_cube", source="contactnets")
    held_out, width = dataset.split("test"), dataset.object.width
    nothing = UnknownObjectSettings(mass=float(dataset.object.mass[0]))
    head = ("model", "tosses", "start", "corners", "corners apart [mm]", "friction", "position [%]", "rotation [deg]")
    console.say("| " + " | ".join((*head, "gravity [m/s²]", "CPU s")) + " |")
    console.say("|" + "---|" * (len(head) + 2))
    for model in MODELS:
        for tosses in TOSSES:
            stated = None
            for start, unknown in (("stated", None), ("nothing", nothing)):
                began = time.process_time()
                trained = tossid.train(dataset, model=model, tosses=tosses, object=unknown)
                seconds = time.process_time() - began
                scores = tossid.evaluate(trained, held_out)
                corners = trained.object.corner_pos * trained.parameters["length_scale"]
                stated = corners if stated is None else stated
                apart = 1e3 * np.linalg.norm(stated[:, None] - corners[None], axis=-1).min(axis=1).max()
                mean = {name: scores.metrics[name]["mean"] for name in ("position_error_pct", "rotation_error_deg")}
                position = mean["position_error_pct"] * scores.stated.width / width
                friction, gravity = trained.object.friction, scores.metrics["gravity_ms2"]["mean"]
                row = [f"`{model}`", f"{tosses}", start, f"{len(corners)}", f"{apart:.2f}", f"{friction:.4f}"]
                row += [f"{position:.1f}", f"{mean['rotation_error_deg']:.1f}", f"{gravity:.2f}", f"{seconds:.0f}"]
                console.say("| " + " | ".join(row) + " |")


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(Path(sys.argv[1])), "unknown"))
