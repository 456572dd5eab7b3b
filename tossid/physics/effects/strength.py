"""How strong an effect is made where it is tried out: a size, and the parameters that follow from it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Values = dict[str, float]
"""Values of an effect by parameter [SI]."""
ValuesOfSize = Callable[[float, Array], Values]
"""Parameters from a size and eight draws between -1 and 1."""


@dataclass(frozen=True)
class Strength:
    """The range of an effect's size, and the parameters of a size.

    Attributes:
        low: The smallest size that is tried.
        high: The largest.
        values: Parameters by name, from a size and draws (8,) between -1 and 1, which set the signs and directions and
            what has no size.
    """

    low: float
    high: float
    values: ValuesOfSize


def sign_of(draws: Array) -> float:
    """The sign of the first draw: 1 or -1."""
    return 1.0 if draws[0] > 0 else -1.0


def plain(name: str) -> ValuesOfSize:
    """Values whose one parameter is the size."""
    return lambda size, u: {name: size}


def signed(name: str, middle: float = 0.0) -> ValuesOfSize:
    """Values whose one parameter is a size above or below a middle."""
    return lambda size, u: {name: middle + sign_of(u) * size}


def scaled(name: str, middle: float = 1.0) -> ValuesOfSize:
    """Values whose one parameter is a middle multiplied or divided by exp(size)."""
    return lambda size, u: {name: middle * math.exp(sign_of(u) * size)}


def directed(*names: str) -> ValuesOfSize:
    """Values of which the size is the length of a vector in a drawn direction, one name for each axis."""
    n = len(names)
    return lambda size, u: dict(zip(names, (size / np.linalg.norm(u[:n]) * u[:n]).tolist(), strict=True))


def between(low: float, high: float, u: float) -> float:
    """A value between two limits, log-uniform if the draw u is uniform between -1 and 1."""
    return low * (high / low) ** (0.5 * (1 + u))
