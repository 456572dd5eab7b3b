"""Engines are compared by distance: none to oneself, and less in shorter steps."""

from __future__ import annotations

from pipelines.tools.experiments.simulated.engine_steps import distances
from tossid.settings.synthesis import LcpEngine


def test_an_engine_is_as_far_as_its_steps_are_long() -> None:
    fine = LcpEngine(substeps=64)
    assert distances(fine, fine, tosses=3, seed=0).max() == 0
    far, near = (distances(LcpEngine(substeps=n), fine, tosses=3, seed=0).max() for n in (1, 16))
    assert near < far
