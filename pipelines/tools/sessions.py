"""What published recordings say of themselves: the tables of docs/experiments/sessions.md.

python -m pipelines.tools.sessions FOLDER
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from pipelines.cli.console import Console
from pipelines.cli.failures import guarded
from tossid.errors import TossidError
from tossid.motion.change_points import robust_mean
from tossid.motion.sessions import find_sessions, session_words
from tossid.motion.witnesses import TILTS, toss_witnesses
from tossid.objects import ObjectModel, load_object
from tossid.store.importers import read_contactnets, read_pll, read_tum
from tossid.types import PoseTrack

Read = Callable[[Path], tuple[ObjectModel, Sequence[PoseTrack]]]


def _tum(folder: str, object_file: str) -> Read:
    def read(data: Path) -> tuple[ObjectModel, Sequence[PoseTrack]]:
        return load_object(data / object_file), read_tum(data / folder, n_joints=0)

    return read


RECORDINGS: dict[str, Read] = {
    "pll_elbow": lambda data: (load_object("elbow"), read_pll(data / "pll_elbow", n_joints=1)),
    "contactnets_cube": lambda data: (load_object("cube"), read_contactnets(data / "contactnets_cube")),
    "mit_die/measured": _tum("mit_die/measured", "mit_die/die.xml"),
    "mit_die/levelled": _tum("mit_die/levelled", "mit_die/die.xml"),
    "basketball": _tum("basketball", "basketball/ball.xml"),
}


def main(data: Path) -> None:
    """Say sessions, tilts and witnesses of each recording."""
    console = Console()
    for name, read in RECORDINGS.items():
        try:
            model, tracks = read(data)
        except TossidError as error:
            console.say(f"{name}: refused: {error}")
            continue
        found = find_sessions(tracks, model, level="session")
        console.say(f"{name}: {len(tracks)} tosses in the order of {found.ordered_by}")
        for note in found.notes:
            console.say(f"  {note}")
        at = {track.name: track for track in tracks}
        for number, session in enumerate(found.sessions):
            console.say(f"  {session_words(session)}")
            own = [at[n] for n, k in zip(found.names, found.session_of, strict=True) if k == number]
            seen = toss_witnesses(own, model)
            rows = []
            for witness, values in seen.values.items():
                mean = robust_mean(values, seen.info[witness])
                factor, unit = (180 / np.pi, "deg") if witness in TILTS else (1.0, "SI")
                sigma = factor * np.sqrt(np.diag(mean.cov))
                cells = [f"{a:.4g} ± {s:.2g}" for a, s in zip(factor * mean.value, sigma, strict=True)]
                rows.append([witness, str(mean.n), ", ".join(cells), unit])
            console.table(("witness", "tosses", "value", "unit"), rows)


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(Path(sys.argv[1])), "sessions"))
