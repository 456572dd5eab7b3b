"""Printed sheets of tags, as an image that faces them shows them."""

from __future__ import annotations

import cv2
import numpy as np

from tossid.vision.setup.layout import FAMILIES

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
