"""Settings of `tossid.diagnose`: which tosses, and how they are judged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from tossid.settings.diagnosis.likelihood import LikelihoodSettings
from tossid.settings.kinds import Bounds, Count, Fraction, Positive, Seed, advanced_part


@dataclass(frozen=True, kw_only=True)
class CheckSettings:
    """Which tosses and simulators are refused."""

    fewest_tosses: Count = 3
    """tosses below which a gap has no interval"""
    still: Positive = 10.0
    """standard deviations of poses within which nothing moves in a toss"""
    simulator_seconds: Positive = 120.0
    """longest that a user's own simulator may take for a call [s]"""
    most_lost: Fraction = 0.2
    """share of the changes of velocity of a user's simulator that a stop at each frame may change; beyond it, effects
    are added to whole motions"""
    size_ratio: Annotated[float, Bounds(above=1)] = 1.6
    """ratio of the sizes of two objects beyond which one is not a wrong statement of the other"""
    most_diverged: Fraction = 0.1
    """share of tosses on which a simulator may diverge"""
    far: Positive = 1e3
    """distance from the origin beyond which a simulated toss has diverged [m]"""


@dataclass(frozen=True, kw_only=True)
class DiagnoseSettings:
    """Which tosses are diagnosed, and how."""

    split: Literal["train", "validation", "test"] | None = None
    """only the tosses of this split; null: all. Of others than the test split, rollouts of that are shown, too"""
    skip: Annotated[int, Bounds(low=0)] = 0
    """how many tosses are left out before the first"""
    tosses: Count | None = None
    """how many tosses; null: those that follow, or some drawn at random where these are many"""
    seed: Seed = 0
    """seed of the draws: which tosses judge, resampling"""
    without: tuple[str, ...] = ()
    """effects of the library that are not considered"""
    threads: Count | None = None
    """threads of the simulator; null: one a core"""
    repeats: Annotated[int, Bounds(low=0)] = 4
    """how often the search is repeated, each time without another part of the tosses, which then judge what it finds;
    0: never, then nothing is said of how sure it is"""
    likelihood: LikelihoodSettings = advanced_part(LikelihoodSettings)
    """how likely tosses are under a simulator"""
    checks: CheckSettings = advanced_part(CheckSettings)
    """what is refused"""
