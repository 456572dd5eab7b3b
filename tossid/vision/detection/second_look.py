"""A second look at some frames where tags are missing: what else their tags, or the images, might be."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from tossid.objects import ObjectModel
from tossid.settings.ingestion import DetectSettings
from tossid.types import Frame
from tossid.vision.detection.detect import tag_detector
from tossid.vision.recordings.recording import Recording
from tossid.vision.setup.layout import FAMILIES

Image = NDArray[np.uint8]

FRAMES = 24
"""So many frames of all cameras together are looked at again."""
FEWEST = 3
"""Frames that have to show tags before anything is said of them."""
NOT_READ = ("tagStandard41h12", "tagStandard52h13", "tagCircle21h7", "tagCircle49h12", "tagCustom48h12")
"""Families of AprilTag that its library knows, and that are not used here."""
ARUCO = {
    "ArUco 4x4": cv2.aruco.DICT_4X4_1000,
    "ArUco 5x5": cv2.aruco.DICT_5X5_1000,
    "ArUco 6x6": cv2.aruco.DICT_6X6_1000,
    "ArUco 7x7": cv2.aruco.DICT_7X7_1000,
    "ArUco original": cv2.aruco.DICT_ARUCO_ORIGINAL,
}
SHORT_CODES = ("tag16h5", "ArUco 4x4", "ArUco original")
"""Codes that clutter shows by chance: two of them have to be seen."""


def _brightened(image: Image) -> Image:
    low, high = np.percentile(image, [1, 99.5])
    return np.clip((image - low) * (255 / max(high - low, 1)), 0, 255).astype(np.uint8)


@dataclass(frozen=True)
class _View:
    """The images as they might be meant, with what is said where they show tags only so."""

    of: Callable[[Image], Image]
    cause: str


VIEWS = {
    "as they are": _View(lambda image: image, ""),
    "brightened": _View(_brightened, "once the images are brightened: they are dark; expected more light or exposure"),
    "inverted": _View(
        lambda image: 255 - image,
        "once black and white are exchanged: the tags are printed white on black, or the images are negatives; "
        "expected black tags on white",
    ),
    "mirrored": _View(
        lambda image: np.ascontiguousarray(image[:, ::-1]),
        "once the images are mirrored: they are mirror images; expected them as the camera sees",
    ),
    "enlarged": _View(
        lambda image: np.asarray(cv2.resize(image, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC), dtype=np.uint8),
        "once the images are enlarged: the tags are small; expected larger tags, nearer cameras or more pixels",
    ),
}


@dataclass
class _Seen:
    """Tags of one family in one view: the frames that show any, and their ids."""

    frames: set[int] = field(default_factory=set)
    ids: set[int] = field(default_factory=set)


def usual_cause(recording: Recording, model: ObjectModel | None, *, settings: DetectSettings) -> str | None:
    """Why no tag, or hardly any, was found, as far as some frames tell.

    Args:
        recording: The recording.
        model: The object with its tags; None where all tags are taken.
        settings: How tags are looked for.

    Returns:
        The cause in words, None where the frames show the object's tags as they are.
    """
    frames = list(_sample(recording))
    layout = recording.layout
    own_ids = set(layout.families) if model is None else {tag.id for tag in model.tags}
    own_families = {layout.families.get(tag_id, layout.tag_family) for tag_id in own_ids} or {layout.tag_family}
    seen: dict[tuple[str, str, bool], _Seen] = defaultdict(_Seen)
    for i, frame in enumerate(frames):
        for name, view in VIEWS.items():
            for family, tag_id in _tags(view.of(frame.image), settings, aruco=name == "as they are"):
                is_own = family in own_families and (tag_id in own_ids or model is None)
                found = seen[name, family, is_own]
                found.frames.add(i)
                found.ids.add(tag_id)
    as_meant = set[int]().union(*(found.frames for (name, _, is_own), found in seen.items() if _plain(name, is_own)))
    others = {
        key: found
        for key, found in seen.items()
        if not _plain(key[0], key[2])
        and len(found.frames) >= max(FEWEST, 2 * len(as_meant) + 1)
        and (key[1] not in SHORT_CODES or len(found.ids) > 1)
    }
    looked = f"{len(frames)} frames that were looked at again"
    if not others:
        views = ", ".join(name for name in VIEWS if VIEWS[name].cause)
        nothing = f"neither {views} nor as another family are tags seen in {looked}; are they in view and in focus?"
        return None if as_meant else nothing
    order = list(VIEWS)
    (name, family, is_own), found = max(others.items(), key=lambda one: (len(one[1].frames), -order.index(one[0][0])))
    ids = ", ".join(map(str, sorted(found.ids)[:6]))
    says = [f"tags of {family} ({ids}) are seen in {len(found.frames)} of {looked}", VIEWS[name].cause]
    if family not in own_families:
        known = f"tagslam.yaml says {', '.join(sorted(own_families))} (key tag_family)"
        says.append(known if family in FAMILIES else f"expected {', '.join(FAMILIES)}")
    elif not is_own and model is not None:
        says.append(f"{model.name} has {', '.join(map(str, sorted(own_ids)))}")
    return "; ".join(part for part in says if part).replace("; once", " once")


def _plain(name: str, is_own: bool) -> bool:
    return name == "as they are" and is_own


def _sample(recording: Recording) -> Iterator[Frame]:
    """Frames from all over the recording, of each camera as many."""
    each = max(FEWEST, FRAMES // max(len(recording.frames), 1))
    for files in recording.frames.values():
        for i in np.unique(np.linspace(0, len(files) - 1, each).astype(int)).tolist():
            yield from recording.run((files[i],))


def _tags(image: Image, settings: DetectSettings, *, aruco: bool) -> Iterator[tuple[str, int]]:
    """Family and id of every tag in an image whose code is read without a corrected bit."""
    with tag_detector((*FAMILIES, *NOT_READ), 1.0, settings.min_margin) as detector:
        for raw in detector.detect(image):
            if raw.hamming == 0 and raw.decision_margin >= settings.min_margin:
                yield raw.tag_family.decode(), int(raw.tag_id)
    if aruco:
        parameters = cv2.aruco.DetectorParameters()
        parameters.errorCorrectionRate = 0.0
        for name, dictionary in ARUCO.items():
            finder = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(dictionary), parameters)
            ids = finder.detectMarkers(image)[1]
            yield from ((name, int(tag_id)) for tag_id in (() if ids is None else ids.ravel()))
