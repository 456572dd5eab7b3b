"""Tosses of known truth, on which hypotheses are fitted and compared."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.diagnosis.tossed import seen, with_effect
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.types import Toss

FRICTION = 0.26
"""Of the tosses of `slippery`; 0.18 is stated."""


@pytest.fixture(scope="session")
def sample_of(cube: ObjectModel) -> Callable[..., Sample]:
    """Samples of tosses of a world."""

    def made(world: World, count: int = 12, *, seed: int = 3) -> Sample:
        return Sample(make_windows(seen(world, cube, count, seed=seed, frames=70), cube), count)

    return made


@pytest.fixture(scope="session")
def slippery_tosses(cube: ObjectModel) -> list[Toss]:
    """Twelve tosses of a cube whose friction is not as stated."""
    return seen(with_effect(cube, "friction", [FRICTION]), cube, 12, seed=3, frames=70)


@pytest.fixture(scope="session")
def slippery(cube: ObjectModel, slippery_tosses: list[Toss]) -> Sample:
    """Their sample."""
    return Sample(make_windows(slippery_tosses, cube), len(slippery_tosses))


@pytest.fixture(scope="session")
def stated(cube: ObjectModel) -> Hypothesis:
    """The cube as it is stated."""
    return Hypothesis(World(cube))
