"""Keys of synthesize."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tossid.settings.objects import ObjectSettings
from tossid.settings.synthesis import SynthesizeSettings


@dataclass(frozen=True, kw_only=True)
class SynthesizeConfig(SynthesizeSettings):
    """Tosses from a simulator, as camera frames or as states, with their truth."""

    object: ObjectSettings
    """what is tossed:"""
    frames: bool
    """camera frames (a recording for ingest), or states (a dataset for train)"""
    out: Path | None
    """folder to write; null: data/raw/OBJECT-ENGINE-SEED"""
