"""A contact sheet: what the cameras saw at some moments, the tags found, and where tracking puts the object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.types import Detection

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]
Colour = tuple[int, int, int]

INK: Colour = (35, 35, 35)
DIM: Colour = (120, 120, 120)
PAPER = 250
FOUND: Colour = (50, 160, 30)
PLACED: Colour = (0, 130, 255)
"""Colours (blue, green, red) of texts, of less important ones, of the page, of tags found and of the object placed."""
GAP, HEAD, FOOT, CAPTION = 10, 66, 40, 24
"""Heights and distances [px]."""


@dataclass(frozen=True, eq=False)
class Cell:
    """One picture of the sheet.

    Attributes:
        camera: Name of the camera.
        t: Time of the frame [s].
        image: (height, width) grey; None where the camera has no frame then.
        found: Tags detected in it.
        placed: Polygons (k, 2) [px] of the object's faces that look at the camera, where tracking puts them.
        rms: Root mean square distance of the detected corners from where tracking puts them [px]; None without a pose.
    """

    camera: str
    t: float
    image: Grey | None
    found: tuple[Detection, ...] = ()
    placed: tuple[Array, ...] = ()
    rms: float | None = None


@dataclass(frozen=True, eq=False)
class Column:
    """One moment.

    Attributes:
        t: Its time [s].
        note: What happens then.
        cells: One a camera.
    """

    t: float
    note: str
    cells: tuple[Cell, ...] = field(default=())


def contact_sheet(columns: Sequence[Column], *, title: str, width: int = 300) -> NDArray[np.uint8]:
    """Draw moments side by side, cameras one below another.

    Each picture shows the neighbourhood of the object, the small one in its corner the whole frame.

    Args:
        columns: The moments.
        title: Stands above.
        width: Of one picture [px].

    Returns:
        (H, W, 3), blue, green, red as OpenCV has it.

    Raises:
        InputError: nothing to draw.
    """
    if not columns or not columns[0].cells:
        raise InputError("no frames to draw a contact sheet of")
    height = round(0.8 * width)
    n_rows, n_columns = len(columns[0].cells), len(columns)
    sheet = np.full(
        (HEAD + n_rows * (height + CAPTION + GAP) + FOOT, max(GAP + n_columns * (width + GAP), 760), 3), PAPER, np.uint8
    )
    _write(sheet, title, (GAP, 24), 0.6, INK)
    for c, column in enumerate(columns):
        left = GAP + c * (width + GAP)
        _write(sheet, f"{column.t:.3f} s", (left, HEAD - 14), 0.5, INK)
        _write(sheet, column.note, (left + 90, HEAD - 14), 0.42, DIM)
        for r, cell in enumerate(column.cells):
            top = HEAD + r * (height + CAPTION + GAP)
            sheet[top : top + height, left : left + width] = _picture(cell, width, height)
            _write(sheet, caption(cell), (left, top + height + 17), 0.42, INK)
    _legend(sheet)
    return sheet


def caption(cell: Cell) -> str:
    """What stands below a picture."""
    if cell.image is None:
        return f"{cell.camera}: no frame"
    tags = ", ".join(str(d.tag_id) for d in sorted(cell.found, key=lambda d: d.tag_id))
    seen = f"tag{'s' * (len(cell.found) > 1)} {tags}" if cell.found else "no tag found"
    if cell.rms is not None:
        return f"{cell.camera}: {seen}; off by {cell.rms:.2f} px"
    return f"{cell.camera}: {seen}" + ("" if cell.placed or not cell.found else "; no pose")


def _picture(cell: Cell, width: int, height: int) -> NDArray[np.uint8]:
    if cell.image is None:
        return np.full((height, width, 3), 215, np.uint8)
    x0, y0, scale = _window(cell, width, height)
    to_view = np.array([[scale, 0, -scale * x0], [0, scale, -scale * y0]])
    view = cv2.warpAffine(
        cell.image,
        to_view,
        (width, height),
        flags=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=215.0,
    )
    picture = np.asarray(cv2.cvtColor(view, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
    for polygon in cell.placed:
        _outline(picture, scale * (polygon - [x0, y0]), PLACED, 1)
    for detection in cell.found:
        corners = scale * (detection.corners - [x0, y0])
        _outline(picture, corners, FOUND, 2)
        _label(picture, str(detection.tag_id), corners)
    _inset(picture, cell.image, (x0, y0, x0 + width / scale, y0 + height / scale))
    return picture


def _window(cell: Cell, width: int, height: int) -> tuple[float, float, float]:
    """First column and row of the part of an image that is shown, and its enlargement."""
    assert cell.image is not None
    rows, columns = cell.image.shape
    whole = min(width / columns, height / rows)
    marks = [d.corners for d in cell.found] + list(cell.placed)
    points = np.concatenate(marks) if marks else np.zeros((0, 2))
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return 0.5 * (columns - width / whole), 0.5 * (rows - height / whole), whole
    low, high = points.min(axis=0), points.max(axis=0)
    span = max(1.6 * float(np.max((high - low) / [width, height])), 40 / width)
    scale = float(np.clip(1 / span, whole, 6.0))
    middle = 0.5 * (low + high)
    return float(middle[0] - 0.5 * width / scale), float(middle[1] - 0.5 * height / scale), scale


def _inset(picture: NDArray[np.uint8], image: Grey, window: tuple[float, float, float, float]) -> None:
    """The whole frame, small, in the upper right corner, with the shown part marked."""
    scale = 0.24 * picture.shape[1] / image.shape[1]
    small = cv2.cvtColor(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), cv2.COLOR_GRAY2BGR)
    x0, y0, x1, y1 = (round(scale * value) for value in window)
    cv2.rectangle(small, (x0, y0), (x1, y1), PLACED, 1, cv2.LINE_AA)
    small = cv2.copyMakeBorder(small, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=(PAPER, PAPER, PAPER))
    h, w = small.shape[:2]
    picture[:h, -w:] = small


def _outline(picture: NDArray[np.uint8], corners: Array, colour: Colour, thickness: int) -> None:
    if np.isfinite(corners).all() and np.abs(corners).max() < 1e5:
        shifted = np.round(corners * 16).astype(np.int32).reshape(-1, 1, 2)
        cv2.polylines(picture, [shifted], True, colour, thickness, cv2.LINE_AA, 4)


def _legend(sheet: NDArray[np.uint8]) -> None:
    y, x = sheet.shape[0] - 16, GAP
    for colour, words, step in (
        (FOUND, "found tag, its id", 190),
        (PLACED, "object where tracking puts it; in the corner: the whole frame", 520),
    ):
        cv2.rectangle(sheet, (x, y - 10), (x + 14, y), colour, 2)
        _write(sheet, words, (x + 22, y), 0.42, DIM)
        x += step


def _label(picture: NDArray[np.uint8], text: str, corners: Array) -> None:
    """A tag's id on a patch, so that it can be read on black and on white; none where it would hide the tag."""
    side = float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).min())
    if side < 22:
        return
    size = 0.5 if side > 40 else 0.36
    (w, h), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)
    middle = corners.mean(axis=0)
    x, y = round(middle[0] - 0.5 * w), round(middle[1] + 0.5 * h)
    cv2.rectangle(picture, (x - 2, y - h - 2), (x + w + 2, y + 2), FOUND, -1)
    _write(picture, text, (x, y), size, (255, 255, 255))


def _write(picture: NDArray[np.uint8], text: str, at: tuple[int, int], size: float, colour: Colour) -> None:
    cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)
