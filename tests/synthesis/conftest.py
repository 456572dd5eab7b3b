"""The tagged cube, a rig and a rendered film, as the vision tests have them."""

from tests.vision.conftest import filmed, rig, tagged, timeline

__all__ = ["filmed", "rig", "tagged", "timeline"]
