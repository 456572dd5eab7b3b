"""Motions after an impact tend to one limit as steps become shorter."""

from __future__ import annotations

import numpy as np

from pipelines.tools.experiments.simulated.step_lengths import AFTER, SUBSTEPS, errors, table


def test_errors_fall_with_the_length_of_steps() -> None:
    found = errors(60)
    assert found.shape == (len(SUBSTEPS), len(AFTER), 2)
    first = np.abs(found[:, 0, 0])
    assert (np.diff(first) < 0).all()
    assert first[-1] < 0.1 * first[0]  # steps a sixteenth as long
    assert first[-1] < 1e-6
    assert table(found).count("\n") == 1 + len(SUBSTEPS)
