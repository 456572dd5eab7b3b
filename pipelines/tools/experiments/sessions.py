"""What published recordings say of themselves: the tables of docs/experiments/sessions.md.

python -m pipelines.tools.experiments.sessions FOLDER [DATASET.h5 …]

Datasets are looked at as they were recorded, before a session was levelled.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from pipelines.cli.console import Console
from pipelines.cli.failures import guarded
from tossid.errors import TossidError
from tossid.motion.sessions import as_recorded, find_sessions, session_words
from tossid.motion.sessions.change_points import robust_mean
from tossid.motion.sessions.smoothing import look_for_smoothing
from tossid.motion.sessions.witnesses import TILTS, toss_witnesses
from tossid.objects import ObjectModel, load_object
from tossid.objects.boxes import box
from tossid.settings.objects import PRESETS
from tossid.store import read_dataset
from tossid.store.importers import read_contactnets, read_pll, read_tum
from tossid.types import PoseTrack

Read = Callable[[Path], tuple[ObjectModel, Sequence[PoseTrack]]]


def _tum(folder: str, model: str | ObjectModel) -> Read:
    def read(data: Path) -> tuple[ObjectModel, Sequence[PoseTrack]]:
        stated = model if isinstance(model, ObjectModel) else load_object(model if model in PRESETS else data / model)
        return stated, read_tum(data / folder, n_joints=0)

    return read


def _dataset(path: Path) -> Read:
    def read(_: Path) -> tuple[ObjectModel, Sequence[PoseTrack]]:
        found = read_dataset(path)
        tosses = [toss if found.order is None else as_recorded(toss, found.order) for toss in found.tosses]
        tracks = []
        for toss in tosses:
            if toss.q_measured is not None:
                tracks.append(PoseTrack(toss.name, toss.t, toss.q_measured, toss.q_measured_cov))
            else:
                tracks.append(PoseTrack(toss.name, toss.t, toss.q, v=toss.v))
        return found.object, tracks

    return read


RECORDINGS: dict[str, Read] = {
    "pll_elbow": lambda data: (load_object("elbow"), read_pll(data / "pll_elbow", n_joints=1)),
    "contactnets_cube": lambda data: (load_object("cube"), read_contactnets(data / "contactnets_cube")),
    "mit_die/measured": _tum("mit_die/measured", "mit_die/die.xml"),
    "mit_die/levelled": _tum("mit_die/levelled", "mit_die/die.xml"),
    "basketball": _tum("basketball", box("ball", (0.238, 0.238, 0.238), 0.6)),
    "smoothed_30hz/milk": _tum("smoothed_30hz/milk", "cube"),
    "smoothed_30hz/egg": _tum("smoothed_30hz/egg", "cube"),
}
"""By name, how each is read. A ball has no corners: the box around it shows its flight, and nothing of contact. Of the
milk carton and the egg no size is published; the signs of a smoother need none."""

FLIGHT_ONLY = ("basketball",)
SMOOTHED = ("smoothed_30hz/milk", "smoothed_30hz/egg")


def main(data: Path, datasets: Sequence[Path] = ()) -> None:
    """Say sessions, tilts and witnesses of each recording, and whether a smoother made it."""
    console, signs = Console(), []
    for name, read in {**RECORDINGS, **{str(path): _dataset(path) for path in datasets}}.items():
        try:
            model, tracks = read(data)
        except TossidError as error:
            console.say(f"{name}: refused: {error}")
            continue
        seen = look_for_smoothing(tracks, model)
        cells = [f"{seen.fall_error:.2f}", str(seen.n_falls), f"{seen.roughness:.2f}", "yes" if seen.smoothed else "no"]
        signs.append([name, str(len(tracks)), *cells])
        if name in SMOOTHED:
            continue
        found = find_sessions(tracks, model, level="session")
        console.say(f"{name}: {len(tracks)} tosses in the order of {found.ordered_by}")
        for note in found.notes:
            console.say(f"  {note}")
        at = {track.name: track for track in tracks}
        for number, session in enumerate(found.sessions):
            console.say(f"  {session_words(session)}")
            own = [at[n] for n, k in zip(found.names, found.session_of, strict=True) if k == number]
            witnesses = toss_witnesses(own, model)
            rows = []
            for witness, values in witnesses.values.items():
                if name in FLIGHT_ONLY and witness not in ("fall", "gravity", "noise"):
                    continue
                mean = robust_mean(values, witnesses.info[witness])
                factor, unit = (180 / np.pi, "deg") if witness in TILTS else (1.0, "SI")
                sigma = factor * np.sqrt(np.diag(mean.cov))
                cells = [f"{a:.4g} ± {s:.2g}" for a, s in zip(factor * mean.value, sigma, strict=True)]
                rows.append([witness, str(mean.n), ", ".join(cells), unit])
            console.table(("witness", "tosses", "value", "unit"), rows)
    head = ("recording", "tosses", "nearest to free fall [m/s²]", "of tosses", "4th / 3rd differences", "smoothed")
    console.table(head, signs, title="signs of a smoother")


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(Path(sys.argv[1]), [Path(each) for each in sys.argv[2:]]), "sessions"))
