"""Settings of `tossid.diagnose`: which tosses, and how they are judged."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Annotated, Literal

from tossid.settings.diagnosis.likelihood import LikelihoodSettings
from tossid.settings.kinds import Bounds, Count, Positive, Seed, advanced_part


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
    simulator_seconds: Positive = 120.0
    """longest that a user's own simulator may take for a call [s]"""
    likelihood: LikelihoodSettings = advanced_part(LikelihoodSettings)
    """how likely tosses are under a simulator"""

    @property
    def n_threads(self) -> int:
        """`threads`, or one a core."""
        return self.threads or os.cpu_count() or 1
