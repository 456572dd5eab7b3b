"""Where tags are sought, what lies against them, and what a second look says of recordings without any."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.vision.films import shot
from tossid.errors import InputError
from tossid.ingestion import stages
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp, transform, transform_points
from tossid.settings.ingestion import DetectSettings
from tossid.settings.rendering import RenderSettings
from tossid.types import Frame
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import look_at
from tossid.vision.detection.detect import BESIDE_HIDDEN, HIDDEN_SIGMA, TagFinder
from tossid.vision.detection.occlusion import hidden_edges
from tossid.vision.detection.second_look import usual_cause
from tossid.vision.recordings.recording import FrameFile, Recording
from tossid.vision.recordings.registry import Opened
from tossid.vision.rendering.render import Renderer
from tossid.vision.setup.faces import tag_corners
from tossid.vision.setup.layout import FAMILIES, Body, BodyTag, TagLayout

DICTIONARIES = {
    "tag36h11": cv2.aruco.DICT_APRILTAG_36H11,
    "tag25h9": cv2.aruco.DICT_APRILTAG_25H9,
    "tag16h5": cv2.aruco.DICT_APRILTAG_16H5,
    "ArUco 5x5": cv2.aruco.DICT_5X5_1000,
}


def poster(tags: dict[int, str]) -> np.ndarray:
    """Tags of several families in a row, black borders 160 px wide from (60, 100), 240 px apart."""
    image = np.full((360, 240 * len(tags) + 40), 230, np.uint8)
    for k, (tag_id, family) in enumerate(tags.items()):
        dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[family])
        x = 60 + 240 * k
        image[100:260, x : x + 160] = cv2.resize(
            cv2.aruco.generateImageMarker(dictionary, tag_id, FAMILIES.get(family, 7)),
            (160, 160),
            interpolation=cv2.INTER_AREA,
        )
    return cv2.GaussianBlur(image, (0, 0), 0.7)


CAMERA = Camera("c", (320, 256), [420, 420, 159.5, 127.5], T_rig_cam=look_at([1.0, 1e-9, 0.5], [0.0, 0.0, 0.5]))
CELL = 420 * 0.01 / (1 - 0.0524)
"""A cell of the tag that faces the camera [px]."""


def _seen(tagged: ObjectModel, turn: float, *, level: float | None, over: float) -> tuple[np.ndarray, np.ndarray]:
    """An image of tag 0 with a grey thing over the right margin and `over` cells of the border, and true corners."""
    q = np.array([0.0, 0.0, 0.5, *quat_exp([0.0, 0.0, turn])])
    image = shot(Renderer(tagged, [CAMERA], RenderSettings(samples=64)), q, "c", np.random.default_rng(1))
    tag = next(tag for tag in tagged.tags if tag.id == 0)
    true = CAMERA.project(transform_points(transform(q[:3], q[3:7]), tag_corners(tag)))
    if level is not None:
        right = round(true[1:3, 0].min() - over * CELL)
        image[:, right : right + 30] = level
    return image, true


@pytest.mark.parametrize(("turn", "level"), [(0.0, 90.0), (0.3, 115.0)])
def test_an_occluder_at_an_edge_is_detected(tagged: ObjectModel, turn: float, level: float) -> None:
    image, true = _seen(tagged, turn, level=level, over=0.3)
    finder = TagFinder(CAMERA, tagged)
    (found,) = (d for d in finder.find(Frame("c", 0.0, image)) if d.tag_id == 0)
    hidden, cell = hidden_edges(image, found.corners, 8)
    np.testing.assert_array_equal(hidden, [False, True, False, False])  # bottom, right, top, left
    assert cell == pytest.approx(CELL, rel=0.12)
    assert finder.tally["edges that may not be the tag's"] > 0
    error = np.linalg.norm(found.corners - true, axis=1)
    sigma = np.sqrt(np.trace(found.corner_cov, axis1=1, axis2=2) / 2)
    assert error[1:3].max() > 0.3
    np.testing.assert_allclose(sigma[1:3], HIDDEN_SIGMA * cell, rtol=0.05)
    np.testing.assert_allclose(sigma[[0, 3]], BESIDE_HIDDEN * HIDDEN_SIGMA * cell, rtol=0.05)
    assert (error < 2 * sigma).all()


@pytest.mark.parametrize("turn", [0.0, 1.0])
def test_a_tag_surrounded_by_paper_is_not_occluded(tagged: ObjectModel, turn: float) -> None:
    image, true = _seen(tagged, turn, level=None, over=0.0)
    hidden, _ = hidden_edges(image, true, 8)
    assert not hidden.any()


OWN = {7: "tag36h11", 3: "tag36h11"}


@dataclass(frozen=True)
class Shown:
    """The same image in all frames."""

    image: np.ndarray

    def images(self, files: Sequence[FrameFile]) -> Iterator[np.ndarray]:
        return (self.image for _ in files)


def film(image: np.ndarray) -> Recording:
    """A recording of one camera that shows an image all the time, of a body with the tags of `OWN`."""
    height, width = image.shape
    tags = tuple(BodyTag(tag_id, 0.1, None, family=family) for tag_id, family in OWN.items())
    return Recording(
        Path("film"),
        (Camera("c", (width, height), [800, 800, width / 2, height / 2]),),
        TagLayout((Body("poster", True, tags=tags),)),
        {"c": [FrameFile("c", i * 10**7, Path(f"{i}.png")) for i in range(5)]},
        Shown(image),
    )


def small(image: np.ndarray) -> np.ndarray:
    """Tags of nine pixels."""
    shrunk = cv2.resize(image, None, fx=9 / 160, fy=9 / 160, interpolation=cv2.INTER_AREA)
    return np.pad(shrunk, 20, constant_values=230)


@pytest.mark.parametrize(
    ("image", "says"),
    [
        (255 - poster(OWN), "once black and white are exchanged: the tags are printed white on black"),
        (np.ascontiguousarray(poster(OWN)[:, ::-1]), "once the images are mirrored: they are mirror images"),
        (poster(OWN) // 24, "once the images are brightened: they are dark"),
        (small(poster(OWN)), "once the images are enlarged: the tags are small"),
        (poster({7: "tag25h9"}), r"tags of tag25h9 \(7\) are seen in 5 of 5 .* tagslam.yaml says tag36h11"),
        (poster({7: "tag16h5", 8: "tag16h5"}), r"tags of tag16h5 \(7, 8\)"),
        (poster({7: "ArUco 5x5"}), r"tags of ArUco 5x5 \(7\) .* expected tag36h11, tag25h9, tag16h5"),
        (np.full((200, 300), 128, np.uint8), "neither brightened, inverted, mirrored, enlarged nor as another family"),
    ],
)
def test_the_usual_causes_are_named(image: np.ndarray, says: str):
    recording, path = film(image), Path("film")
    opened = Opened(
        path=path, folder=path, cameras=recording.cameras, layout=recording.layout, recording=recording
    )  # fmt: skip
    with pytest.raises(InputError, match=rf"no tag was seen in 5 images; .*{says}"):
        list(stages.detect(opened))


def test_ids_that_are_not_on_the_object_are_named(tagged):
    cause = usual_cause(film(poster({37: "tag36h11"})), tagged, settings=DetectSettings())
    assert cause.endswith(
        "tags of tag36h11 (37) are seen in 5 of 5 frames that were looked at again; cube has 0, 1, 2, 3, 4, 5"
    )


def test_tags_that_are_seen_as_they_are_have_no_such_cause():
    assert usual_cause(film(poster(OWN)), None, settings=DetectSettings()) is None
    both = np.concatenate([poster(OWN), 255 - poster(OWN)])  # one more sheet in the room
    assert usual_cause(film(both), None, settings=DetectSettings()) is None
