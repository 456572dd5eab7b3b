"""Kinds of values: limits that numbers and pairs keep, and the object that most commands share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated


@dataclass(frozen=True, slots=True)
class Bounds:
    """Limits of a number, inclusive; `above`: exclusive lower limit."""

    low: float | None = None
    high: float | None = None
    above: float | None = None


@dataclass(frozen=True, slots=True)
class Ordered:
    """Marks a pair of limits: the first is not above the second."""


Positive = Annotated[float, Bounds(above=0)]
NonNegative = Annotated[float, Bounds(low=0)]
Count = Annotated[int, Bounds(low=1)]
Fraction = Annotated[float, Bounds(low=0, high=1)]
Range = Annotated[tuple[float, float], Ordered()]
Span = Annotated[tuple[NonNegative, NonNegative], Ordered()]
Seed = Annotated[int, Bounds(low=0, high=2**32 - 1)]


@dataclass(frozen=True)
class ObjectConfig:
    """The object that is tossed."""

    name: str
    """what it is called"""
    path: Path
    """its MJCF or URDF file; a relative path is sought in the working folder, then in tossid's own"""
    friction: NonNegative
    """Coulomb friction of object and ground"""
    restitution: Annotated[float, Bounds(low=0, high=1)]
    """Newton's restitution, 0 for none"""
    width: Positive | None
    """length that position errors refer to [m]; null: the longest edge of the base"""
    tags: Path | None
    """its AprilTags, in TagSLAM's tagslam.yaml form; null: none"""
