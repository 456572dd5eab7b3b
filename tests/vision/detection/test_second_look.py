"""What a second look says of recordings in which no tag is found."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.vision.posters import poster
from tossid.errors import InputError
from tossid.ingestion import stages
from tossid.settings.ingestion import DetectSettings
from tossid.vision.cameras.camera import Camera
from tossid.vision.detection.second_look import usual_cause
from tossid.vision.recordings.recording import FrameFile, Recording
from tossid.vision.recordings.registry import Opened
from tossid.vision.setup.layout import Body, BodyTag, TagLayout

OWN = {7: "tag36h11", 3: "tag36h11"}


@dataclass(frozen=True)
class Shown:
    """The same image in all frames."""

    image: np.ndarray

    def images(self, files: Sequence[FrameFile]) -> Iterator[np.ndarray]:
        return (self.image for _ in files)


def film(image: np.ndarray, listed: dict[int, str] = OWN, n: int = 5) -> Recording:
    """A recording of one camera that shows an image all the time, of a body that has the listed tags."""
    height, width = image.shape
    tags = tuple(BodyTag(tag_id, 0.1, None, family=family) for tag_id, family in listed.items())
    return Recording(
        Path("film"),
        (Camera("c", (width, height), [800, 800, width / 2, height / 2]),),
        TagLayout((Body("poster", True, tags=tags),)),
        {"c": [FrameFile("c", i * 10**7, Path(f"{i}.png")) for i in range(n)]},
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
    recording = film(image)
    with pytest.raises(InputError, match=rf"no tag was seen in 5 images; .*{says}"):
        opened = Opened(
            path=Path("film"),
            folder=Path("film"),
            cameras=recording.cameras,
            layout=recording.layout,
            recording=recording,
        )
        list(stages.detect(opened))


def test_ids_that_are_not_on_the_object_are_named(tagged):
    cause = usual_cause(film(poster({37: "tag36h11"})), tagged, settings=DetectSettings())
    assert cause is not None
    assert cause.endswith(
        "tags of tag36h11 (37) are seen in 5 of 5 frames that were looked at again; cube has 0, 1, 2, 3, 4, 5"
    )


def test_tags_that_are_seen_as_they_are_have_no_such_cause():
    assert usual_cause(film(poster(OWN)), None, settings=DetectSettings()) is None
    both = np.concatenate([poster(OWN), 255 - poster(OWN)])  # one more sheet in the room
    assert usual_cause(film(both), None, settings=DetectSettings()) is None
