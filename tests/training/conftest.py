from __future__ import annotations

from tests.models.conftest import cube, elbow

__all__ = ["cube", "elbow"]
