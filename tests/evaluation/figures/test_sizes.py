"""Costs are drawn where they belong, in seconds above and in memory below."""

from __future__ import annotations

import numpy as np

from tests.evaluation.figures.reading import assert_legible
from tossid.evaluation.figures import costs_of_size

COSTS = {
    "tosses [count]": {
        "train": [(10.0, 20.0, 0.7), (1000.0, 200.0, 1.7)],
        "ingest": [(10.0, 4.0, 0.3), (1000.0, 24.0, 0.3)],
    },
    "film [min]": {"ingest film": [(1.0, 72.0, 0.6), (60.0, 3600.0, 0.6)]},
}


def test_every_command_has_a_line_of_seconds_and_one_of_memory() -> None:
    figure = costs_of_size(COSTS)
    assert_legible(figure)
    for column, commands in enumerate(COSTS.values()):
        for row in (0, 1):
            ax = figure.axes[row * len(COSTS) + column]
            drawn = {str(line.get_label()): line for line in ax.get_lines()}
            assert drawn.keys() == commands.keys()
            for name, costs in commands.items():
                np.testing.assert_allclose(drawn[name].get_ydata(), [cost[row + 1] for cost in costs])
