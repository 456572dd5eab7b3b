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

FRICTION = 0.26
"""Of the tosses of `slippery`; 0.18 is stated."""


@pytest.fixture(scope="session")
def sample_of(cube: ObjectModel) -> Callable[..., Sample]:
    """Samples of tosses of a world."""

    def made(world: World, count: int = 12, *, seed: int = 3) -> Sample:
        return Sample(make_windows(seen(world, cube, count, seed=seed, frames=70), cube), count)

    return made


@pytest.fixture(scope="session")
def slippery(cube: ObjectModel, sample_of: Callable[..., Sample]) -> Sample:
    """Twelve tosses of a cube whose friction is not as stated."""
    return sample_of(with_effect(cube, "friction", [FRICTION]))


@pytest.fixture(scope="session")
def stated(cube: ObjectModel) -> Hypothesis:
    """The cube as it is stated."""
    return Hypothesis(World(cube))
