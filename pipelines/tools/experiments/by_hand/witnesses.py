"""What the tosses of a dataset say of inertia, rebound and friction without a simulator.

    python -m pipelines.tools.experiments.by_hand.witnesses FILE.h5 [--split train] [--effects '{"wind": {"x_ms": 1}}']

These are the witnesses of a diagnosis's report (`localisation.witnesses`). The effects say where the centre of mass and
the corners are, and what the recording has wrong. Without a split all tosses are asked.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from tossid.diagnosis.audit.strengths import world_with
from tossid.diagnosis.localisation.witnesses import witnesses
from tossid.physics.effects import World
from tossid.store import read_dataset


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--split", nargs="*", default=[])
    parser.add_argument("--effects", default="{}", help="values by effect and parameter, as JSON")
    given = parser.parse_args()
    dataset = read_dataset(given.data)
    tosses = [toss for split in given.split for toss in dataset.of_split(split)] or list(dataset.tosses)
    stated = World(dataset.object)
    print("| quantity | stated | with the effects | measured (95 %) | tosses |\n|---|---|---|---|---|")  # noqa: T201
    for said in witnesses(tosses, stated, world_with(stated, json.loads(given.effects))):
        value = said.measured
        measured = f"{value.value:.3g} ({value.low:.3g} to {value.high:.3g})"
        print(f"| {said.quantity} | {said.stated:.3g} | {said.found:.3g} | {measured} | {said.tosses} |")  # noqa: T201


if __name__ == "__main__":
    main()
