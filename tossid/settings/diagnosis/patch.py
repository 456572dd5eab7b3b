"""Settings of a patch: how it is written, and how it is run in MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass

from tossid.settings.kinds import Count, Positive


@dataclass(frozen=True, kw_only=True)
class PatchSettings:
    """How a patch is written, and how it is run in MuJoCo."""

    steps_per_swing: Positive = 20.0
    """MuJoCo steps within 1 / omega of a contact's spring"""
    most_steps: Count = 400_000
    """MuJoCo steps beyond which fewer tosses are run"""
    fewest_tosses: Count = 6
    """tosses that are run in any case"""
