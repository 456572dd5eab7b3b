"""What the tosses of a dataset say of inertia, rebound and friction without a simulator.

    python -m pipelines.tools.experiments.by_hand.witnesses FILE.h5 [--split train] [--effects '{"wind": {"x_ms": 1}}']

These are the witnesses of a diagnosis's report (`localisation.witnesses`). The effects say where the centre of mass and
the corners are, and what the recording has wrong. Without a split all tosses are asked.
"""

from __future__ import annotations

from pipelines.tools.experiments.by_hand.given import arguments, asked
from tossid.diagnosis.localisation.witnesses import witnesses
from tossid.physics.effects import World


def main() -> None:
    """Print a table."""
    dataset, tosses, world = asked(arguments(__doc__, split=()).parse_args())
    stated = World(dataset.object)
    print("| quantity | stated | with the effects | measured (95 %) | tosses |\n|---|---|---|---|---|")  # noqa: T201
    for said in witnesses(tosses or dataset.tosses, stated, world):
        value = said.measured
        measured = f"{value.value:.3g} ({value.low:.3g} to {value.high:.3g})"
        print(f"| {said.quantity} | {said.stated:.3g} | {said.found:.3g} | {measured} | {said.tosses} |")  # noqa: T201


if __name__ == "__main__":
    main()
