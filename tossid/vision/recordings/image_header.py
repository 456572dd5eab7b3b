"""The size of an image from its header, so that an image is decoded only where its pixels fit the budget."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from tossid import budget
from tossid.errors import FileError

_PNG = b"\x89PNG\r\n\x1a\n"
"""The first bytes of a PNG."""
_START_OF_FRAME = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""JPEG's markers that an image's size follows."""
_ALONE = frozenset({0x01, *range(0xD0, 0xD9)})
"""JPEG's markers without a length."""
_START_OF_SCAN, _END = 0xDA, 0xD9
"""JPEG's markers after which no size follows."""
_WIDTHS, _HEIGHTS = (256, 322), (257, 323)
"""TIFF's tags of an image's and of a tile's size."""


Pixels = NDArray[np.uint8] | NDArray[np.uint16]
"""Grey levels of an image as it is stored."""


def grey_pixels(path: Path, content: bytes) -> Pixels | None:
    """The pixels of an encoded image.

    Args:
        path: The file that it comes from, for the error.
        content: PNG, JPEG, BMP, PBM, PGM, PPM or TIFF.

    Returns:
        (height, width) grey levels of 8 or 16 bits; None where it cannot be decoded.

    Raises:
        FileError: It claims more pixels than `ReadLimits.pixels`, repeats them beyond `ReadLimits.scanned`, or has a
            chunk that claims more bytes than there are.
    """
    size = image_size(content)
    if size is None:
        return None
    budget.check_pixels(path, *size)
    if content.startswith(_PNG):
        _check_png_chunks(path, content)
    if content.startswith(b"\xff\xd8"):
        scans = content.count(bytes([0xFF, _START_OF_SCAN]))
        claimed = scans * size[0] * size[1]
        budget.check_claim(path, f"pixels in its {scans} scans", claimed, budget.limits().scanned)
    encoded = np.frombuffer(content, dtype=np.uint8)
    try:
        image = cv2.imdecode(encoded, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
        if image is not None and image.dtype not in (np.uint8, np.uint16):
            image = cv2.imdecode(encoded, cv2.IMREAD_GRAYSCALE)
    except cv2.error:
        return None
    if image is None or image.dtype != np.uint16:
        return None if image is None else np.asarray(image, dtype=np.uint8)
    return np.asarray(image, dtype=np.uint16)


def image_size(content: bytes) -> tuple[int, int] | None:
    """Width and height [px] that an image's header claims; None for what is no image of a known format."""
    try:
        if content.startswith(_PNG) and content[12:16] == b"IHDR":
            width, height = struct.unpack(">II", content[16:24])
            return width, height
        if content.startswith(b"\xff\xd8"):
            return _jpeg_size(content)
        if content.startswith(b"BM"):
            return _bmp_size(content)
        if content.startswith((b"II*\0", b"MM\0*")):
            return _tiff_size(content)
    except (struct.error, IndexError):
        return None
    return _pnm_size(content)


def _check_png_chunks(path: Path, content: bytes) -> None:
    """Refuse chunks that are longer than the file: OpenCV takes their memory before it reads them."""
    at = len(_PNG)
    while at + 8 <= len(content):
        length, name = struct.unpack_from(">I4s", content, at)
        left = len(content) - at - 8
        if length > left:
            raise FileError(
                path, f"its chunk {name.decode('latin-1')!r} claims {length:,} bytes, of which it has {left:,}"
            )
        at += 12 + length


def _jpeg_size(content: bytes) -> tuple[int, int] | None:
    """The largest of the frames that are announced before the first scan."""
    found, at = None, 2
    while (at := content.find(b"\xff", at)) >= 0:
        at += 1
        marker = content[at]
        if marker in (0x00, 0xFF) or marker in _ALONE:
            continue
        if marker in (_START_OF_SCAN, _END):
            break
        length = struct.unpack_from(">H", content, at + 1)[0]
        if marker in _START_OF_FRAME:
            height, width = struct.unpack_from(">HH", content, at + 4)
            found = (width, height) if found is None else (max(width, found[0]), max(height, found[1]))
        at += 1 + length
    return found


def _bmp_size(content: bytes) -> tuple[int, int]:
    old = struct.unpack_from("<I", content, 14)[0] == 12
    width, height = struct.unpack_from("<HH" if old else "<ii", content, 18)
    return abs(width), abs(height)


def _tiff_size(content: bytes) -> tuple[int, int] | None:
    """Of the first image; a tile that is larger counts."""
    order = "<" if content.startswith(b"II") else ">"
    first = struct.unpack_from(f"{order}I", content, 4)[0]
    width = height = 0
    for k in range(struct.unpack_from(f"{order}H", content, first)[0]):
        at = first + 2 + 12 * k
        tag, kind = struct.unpack_from(f"{order}HH", content, at)
        value = struct.unpack_from(f"{order}{'H' if kind == 3 else 'I'}", content, at + 8)[0]
        width = max(width, value) if tag in _WIDTHS else width
        height = max(height, value) if tag in _HEIGHTS else height
    return (width, height) if width and height else None


def _pnm_size(content: bytes) -> tuple[int, int] | None:
    gap = rb"(?:\s|#[^\n]*\n)+"
    found = re.match(rb"P[1-6]" + gap + rb"(\d{1,18})" + gap + rb"(\d{1,18})", content[:4096])
    return (int(found[1]), int(found[2])) if found else None
