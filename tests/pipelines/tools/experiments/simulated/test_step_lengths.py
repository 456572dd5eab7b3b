"""Motions after an impact tend to one limit as steps become shorter."""

from __future__ import annotations

import numpy as np
import pytest

from pipelines.tools.experiments.simulated.step_lengths import AFTER, SUBSTEPS, errors, table


@pytest.mark.parametrize("restitution", [0.0, 0.3])
def test_errors_fall_with_the_length_of_steps(restitution: float) -> None:
    found = errors(100, restitution)
    assert found.shape == (len(SUBSTEPS), len(AFTER), 2)
    first = np.abs(found[:, 0, 0])
    assert first[0] < 4e-6  # of a fall of some centimetres, in steps of 1.7 ms
    assert first[-1] < 3e-7
    assert table(found).count("\n") == 1 + len(SUBSTEPS)
