"""Keys of audit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pipelines.config.schemas.launching import Launcher
from tossid.settings.audit import AuditSettings
from tossid.settings.kinds import Count
from tossid.settings.objects import ObjectSettings


@dataclass(frozen=True, kw_only=True)
class AuditConfig(AuditSettings):
    """Check diagnose on tosses whose effect is withheld from it, case by case; an interrupted audit goes on."""

    object: ObjectSettings
    """what is tossed"""
    out: Path | None
    """folder of the audit; null: outputs/audit/SEED"""
    workers: Count | None
    """cases at the same time; null: one a core, or as many as the cluster has workers"""
    launcher: Launcher
    """who computes the cases:"""
