"""Random starts of training, and how far from each other trainings end.

What a model learns should not depend on where it starts. `random_starts` draws corners, friction, inertia and the given
gravity anew; `end_difference` compares two trained models.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.models import TrainedModel
from tossid.models.random_start import draw_start
from tossid.objects import GRAVITY, ObjectModel, to_mjcf

Array = NDArray[np.float64]


class Start(NamedTuple):
    """A start of training.

    Attributes:
        object: With its corners, friction and inertia.
        gravity: That is given to the model [m/s²].
        corners: How the corners were drawn: "ball" or "offset".
        inertia_rel: Inertia relative to the stated one.
    """

    object: ObjectModel
    gravity: float
    corners: str
    inertia_rel: float


class EndDifference(NamedTuple):
    """How far a training ended from another one.

    Attributes:
        corners: Largest distance of one of the other's corners from the nearest learned one, and the reverse [m].
        friction: Difference of friction.
    """

    corners: float
    friction: float


def random_starts(stated: ObjectModel, count: int, *, continuous: bool = True, seed: int = 0) -> list[Start]:
    """Starts of which nothing is right but the centre of mass, the mass and the number of corners.

    Every second one has its corners evenly in a ball about the body's origin, the others have each coordinate of a
    stated corner off by a normal number. Friction and inertia are log-uniform. Every two starts, the given gravity
    changes between 9.81 m/s² and none.

    Args:
        stated: The object as it is stated.
        count: How many.
        continuous: Whether inertia and gravity are drawn; if not they are as stated, for a model that is given them.
        seed: Of what is drawn.
    """
    found = []
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        kind = ("ball", "offset")[number % 2]
        model, scale = draw_start(stated, rng, ball=kind == "ball", inertia=continuous)
        gravity = (0.0, GRAVITY)[(number // 2) % 2] if continuous else GRAVITY
        found.append(Start(model.with_changes(mjcf=to_mjcf(model)), gravity, kind, scale))
    return found


def end_difference(model: TrainedModel, other: TrainedModel) -> EndDifference:
    """How far a training ended from another one of the same tosses.

    A corner that neither has seen on the ground is not compared: no toss decides where it is.

    Args:
        model: The one.
        other: The other.
    """
    one, two = (_seen(trained) for trained in (model, other))
    if not len(one) or not len(two):
        return EndDifference(float("inf"), abs(model.object.friction - other.object.friction))
    distance = np.linalg.norm(one[:, None] - two[None], axis=-1)
    apart = max(distance.min(axis=0).max(), distance.min(axis=1).max())
    return EndDifference(float(apart), abs(model.object.friction - other.object.friction))


def _seen(trained: TrainedModel) -> Array:
    """Learned corners that tosses have shown, in the recorded frame of the first body (n, 3)."""
    geometry = trained.parameters["geometry"][0]
    return np.array(geometry["vertices_m"])[np.array(geometry["seen"], dtype=bool)].reshape(-1, 3)
