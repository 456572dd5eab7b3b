"""A recording of a few small frames of noise."""

from __future__ import annotations

import numpy as np

from tossid.types import Frame
from tossid.vision.cameras.camera import Camera

CAMERA = Camera("left", (64, 48), [60, 60, 32, 24])


def small_frames(n: int = 4) -> list[Frame]:
    rng = np.random.default_rng(0)
    return [Frame("left", 0.1 + i / 100, rng.integers(0, 255, (48, 64), dtype=np.uint8)) for i in range(n)]
