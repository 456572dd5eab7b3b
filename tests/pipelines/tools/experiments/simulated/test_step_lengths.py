"""Motions after an impact tend to one limit as steps become shorter."""

from __future__ import annotations

import numpy as np
import pytest

from pipelines.tools.experiments.simulated.step_lengths import AFTER, DEFAULTS, SUBSTEPS, errors, main, table


@pytest.mark.parametrize("restitution", [0.0, 0.3])
def test_errors_fall_with_the_length_of_steps(restitution: float) -> None:
    found = errors({**DEFAULTS, "tosses": 100, "restitution": restitution})
    assert found.shape == (len(SUBSTEPS), len(AFTER), 100, 3)
    two_frames = np.median(np.linalg.norm(found[:, 0], axis=-1), axis=-1)
    assert two_frames[SUBSTEPS.index(2)] < 1e-6  # of a fall of some centimetres, in steps of 3.4 ms
    assert two_frames[-1] < 1e-7
    assert table(found).count("\n") == 1 + len(SUBSTEPS)


def test_another_key_is_an_error() -> None:
    with pytest.raises(SystemExit, match="no key bounce; expected tosses"):
        main(["bounce=1"])
