from __future__ import annotations

from tests.models.conftest import cube

__all__ = ["cube"]
