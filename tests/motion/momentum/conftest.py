from dataclasses import dataclass

import pytest

from tossid.motion import tosses_from_tracks
from tossid.objects import ObjectModel, unstated_object
from tossid.settings.synthesis import ShapeTossSettings
from tossid.synthesis.shapes import toss_shape
from tossid.types import Toss


@dataclass(frozen=True)
class Tossed:
    """Noisy tosses of a wedge, and the wedge as it is."""

    tosses: tuple[Toss, ...]
    true: ObjectModel


@pytest.fixture(scope="package")
def wedge() -> Tossed:
    """MuJoCo's friction is not Coulomb's in impacts, which the balance of momentum does not mind."""
    made = toss_shape("wedge", ShapeTossSettings(tosses=20))
    tosses = tosses_from_tracks(made.tracks, unstated_object())
    return Tossed(tosses, made.object)
