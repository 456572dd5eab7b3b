"""First states that flights gave, kept until the model has changed so much that they would be others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tossid.models.shots import flight_starts
from tossid.motion import FlightState
from tossid.objects import ObjectModel
from tossid.settings.training import RolloutSettings
from tossid.types import Toss


@dataclass(frozen=True)
class Flights:
    """First states that flights gave, for a model as it was.

    Attributes:
        model: The object then.
        gravity: In flight [m/s²].
        fitted: First states of training and validation tosses; None where there is too little flight.
    """

    model: ObjectModel
    gravity: float
    fitted: tuple[list[FlightState | None], ...]

    COM_REL, INERTIA_REL, GRAVITY_REL = 1e-3, 0.01, 1e-3
    """Changes (in widths, and relative) on which first states do not depend."""

    def outdated(self, model: ObjectModel, gravity: float) -> bool:
        """Whether flights would give other first states now.

        Args:
            model: The object now.
            gravity: In flight [m/s²].
        """
        return bool(
            np.abs(model.com - self.model.com).max() > self.COM_REL * model.width
            or np.abs(model.inertia - self.model.inertia).max() > self.INERTIA_REL * np.abs(self.model.inertia).max()
            or abs(gravity - self.gravity) > self.GRAVITY_REL * max(abs(gravity), 1.0)
        )


def fit_flights(
    model: ObjectModel, tosses: Sequence[Sequence[Toss]], gravity: float, settings: RolloutSettings, n_threads: int = 1
) -> Flights:
    """First states of sets of tosses as their flights give them.

    Args:
        model: The object as it is estimated.
        tosses: Of training and of validation, with true lengths.
        gravity: In flight [m/s²].
        settings: How much flight is enough.
        n_threads: Over which tosses are split.
    """
    frames = settings.min_flight_frames
    fitted = tuple(
        flight_starts(model, each, gravity=gravity, min_frames=frames, n_threads=n_threads) for each in tosses
    )
    return Flights(model, gravity, fitted)
