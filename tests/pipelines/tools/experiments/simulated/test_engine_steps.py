"""Engines are compared by distance: none to oneself, less in shorter steps, and least to one's own law of contact."""

from __future__ import annotations

from pipelines.tools.experiments.simulated.engine_steps import LAWS, after_impact, distances, motions
from tossid.settings.synthesis import LcpEngine


def test_an_engine_is_as_far_as_its_steps_are_long() -> None:
    fine = motions(LcpEngine(substeps=64), 3, 0)
    assert distances(fine, fine).max() == 0
    far, near = (distances(motions(LcpEngine(substeps=n), 3, 0), fine).max() for n in (1, 16))
    assert near < far


def test_an_engine_is_nearest_to_its_own_law() -> None:
    engine = LcpEngine(substeps=64)
    off = {name: after_impact(motions(engine, 12, 5), motions(engine, 12, 5, law)) for name, law in LAWS.items()}
    assert off["after it"] == 0
    assert off["as it turns"] > 0.3
    assert off["relaxed"] > 0.3
