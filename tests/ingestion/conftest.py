"""The cube with its tags, and the film of it that the vision tests look at, too."""

from __future__ import annotations

from tests.vision.conftest import filmed, rig, tagged

__all__ = ["filmed", "rig", "tagged"]
