"""A camera before a wall of tags, for several tests."""

from __future__ import annotations

import numpy as np

from tests.vision.sights import alike
from tossid.rotations import transform
from tossid.types import Detection
from tossid.vision.cameras.camera import Camera
from tossid.vision.setup.layout import Body, BodyTag, TagLayout


def wall(rng: np.random.Generator, *, noise: float = 0.0) -> tuple[list[Detection], list[Camera], TagLayout]:
    """A camera before a wall of four tags, one of them known: a metre apart."""
    camera = Camera("cam0", (1280, 1024), [900, 900, 640, 512], rig_body="rig", T_world_rig=None)
    places = [transform(np.array([x, y, 3.0]), np.array([0.0, 1, 0, 0])) for x in (-0.5, 0.5) for y in (-0.4, 0.4)]
    known = BodyTag(0, 0.2, places[0])
    lab = Body("lab", True, np.eye(4), 0.2, (known, *(BodyTag(i, 0.2, None) for i in (1, 2, 3))))
    detections = []
    square = 0.1 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    for i in range(30):
        T = transform(np.array([0.3, 0.2, 0.5]) * np.sin(i / 4 + np.arange(3)), np.array([1.0, 0, 0, 0]))
        for tag_id, place in enumerate(places):
            world = square @ place[:3, :3].T + place[:3, 3]
            pixels = camera.distort((world - T[:3, 3]) @ T[:3, :3])[0] + noise * rng.normal(size=(4, 2))
            detections.append(Detection("cam0", i / 10, tag_id, pixels, alike(max(noise, 0.1))))
    return detections, [camera], TagLayout((lab, Body("rig", False)))
