"""Settings of an audit: diagnoses of tosses whose effect is withheld."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from tossid.settings.kinds import Bounds, Count, Ordered, Positive, Seed

CaseKind = Literal["effect", "null", "pair", "recording", "four", "eight", "outside", "without"]
"""What is in a drawn case: an effect of the library, nothing, two effects of different families, two errors of one
recording, four or eight effects at once, a force that the library lacks, or an effect that is then taken out of the
library."""


@dataclass(frozen=True, kw_only=True)
class AuditSettings:
    """Which cases an audit has, and how they are made and diagnosed."""

    cases: Count = 20
    """how many cases; those of a smaller number are the first of them"""
    seed: Seed = 0
    """seed of the cases"""
    tosses: Annotated[int, Bounds(low=6)] = 40
    """tosses a case"""
    engines: tuple[Literal["lcp", "mujoco", "drake", "bullet"], ...] = ("lcp", "mujoco")
    """what simulates, in turns; where one cannot express the effect, lcp. drake and bullet need
    `pip install 'tossid[engines]'`"""
    repeats: Annotated[int, Bounds(low=0)] = 4
    """as of `diagnose`"""
    kinds: tuple[CaseKind, ...] = ("effect",) * 5 + ("null",) * 2 + ("pair", "outside", "without")
    """what is in cases: every so many cases are these, in a drawn order"""
    filmed: bool = False
    """film the tosses with three cameras and track the tags in their images; false: poses with normal noise"""
    position_noise: Positive = 1.5e-4
    """standard deviation of recorded positions [m]"""
    rotation_noise: Positive = 1.5e-3
    """standard deviation of recorded orientations [rad]"""
    displacement: Annotated[tuple[Positive, Positive], Ordered()] = (8.0, 300.0)
    """how far an effect moves the object (median over a toss), over the position noise: drawn between these"""
