"""How rough predictions of contact are: how far they jump where a tilt of the ground changes by 10 µrad.

    python -m pipelines.tools.experiments.rough_contact DATA.h5 [tosses=40] [split=train]

Windows of recorded tosses, as a diagnosis cuts them, are predicted from their recorded first states under tilts from 0
to 0.4 mrad. Of each window that has contact, the table has the largest second difference of the centre's last position.
A smooth prediction has none. Worlds are the stated cube, and what the published cube's diagnosis finds, added in turn.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from tossid.diagnosis.diagnose import prepare
from tossid.diagnosis.likelihood.windows import Windows, make_windows
from tossid.objects import ObjectModel
from tossid.physics.effects import World, effect_named
from tossid.settings.changed import changed
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.store import read_dataset
from tossid.types import Toss

Array = NDArray[np.float64]
TILTS = np.linspace(0.0, 4e-4, 41)
"""About x [rad]."""
QUANTILES = (0.5, 0.75, 0.9)
BOUNCING: Mapping[str, Sequence[float]] = {"restitution": [0.3]}
FOUND: Mapping[str, Sequence[float]] = {**BOUNCING, "inertia": [1.33], "friction": [0.17]}
WORLDS: dict[str, Mapping[str, Sequence[float]]] = {
    "as stated": {},
    "restitution 0.3": BOUNCING,
    "and inertia 1.33, friction 0.17": FOUND,
    "and adhesion 0.15 N": {**FOUND, "adhesion": [0.15]},
    "or cohesion 0.04 N": {**FOUND, "cohesion": [0.04]},
    "or size 0.967": {**FOUND, "geometry": [0.967]},
    "both of these": {**FOUND, "cohesion": [0.04], "geometry": [0.967]},
}
"""Effects of each world, with their values."""


def jumps(windows: Windows, model: ObjectModel, effects: Mapping[str, Sequence[float]]) -> Array:
    """(W,) largest second difference of each window's last position over `TILTS` [m].

    Args:
        windows: Cut from tosses.
        model: Their object.
        effects: Of the world, beside the tilt.
    """
    world = World(model)
    for name, values in effects.items():
        world = effect_named(name).at(world, np.array(values))
    last, tilted = windows.inside.sum(axis=1) - 1, effect_named("ground_tilt")
    ends = []
    for tilt in TILTS:
        predicted = windows.predicted(tilted.at(world, np.array([tilt, 0.0])))
        ends.append(predicted[np.arange(len(last)), last, :3])
    change = np.diff(np.array(ends), n=2, axis=0)
    return np.asarray(np.abs(change).max(axis=(0, 2)))


def table(tosses: Sequence[Toss], model: ObjectModel, settings: DiagnoseSettings) -> str:
    """The quantiles of `jumps` over windows with contact, in Markdown, a row for each of `WORLDS`.

    Args:
        tosses: As recorded.
        model: Their object.
        settings: How windows are cut.
    """
    windows = make_windows(tosses, model, settings=settings.likelihood)
    touching = windows.rows(np.flatnonzero(~windows.free))
    heads = [f"{100 * each:g} % of windows [µm]" for each in QUANTILES]
    rows = [f"| world | {' | '.join(heads)} |", "|---" * (1 + len(heads)) + "|"]
    for name, effects in WORLDS.items():
        found = 1e6 * np.quantile(jumps(touching, model, effects), QUANTILES)
        rows.append(f"| {name} | {' | '.join(f'{each:.0f}' for each in found)} |")
    return "\n".join(rows)


def main(arguments: list[str]) -> None:
    """Print the table.

    Args:
        arguments: A dataset, then `key=value` of `tossid diagnose`.
    """
    path, *keys = arguments
    given = dict(each.split("=", 1) for each in keys)
    settings = changed(DiagnoseSettings(), {name: yaml.safe_load(value) for name, value in given.items()})
    task = prepare(read_dataset(Path(path)), settings=settings)
    sys.stdout.write(table(task.tosses, task.recorded, settings) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
