"""Images decoded only where what their headers claim fits the budget."""

from __future__ import annotations

import struct
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL.BmpImagePlugin import BmpImageFile
from PIL.ImageFile import ImageFile
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile
from PIL.PpmImagePlugin import PpmImageFile
from PIL.TiffImagePlugin import TiffImageFile

from tossid import budget
from tossid.errors import FileError

_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
"""The first bytes of these formats."""
_HEADERS: dict[bytes, type[ImageFile]] = {
    _PNG: PngImageFile,
    _JPEG: JpegImageFile,
    b"BM": BmpImageFile,
    b"P": PpmImageFile,
    b"II*\0": TiffImageFile,
    b"MM\0*": TiffImageFile,
}
"""What reads the header of an image that begins so; the pixels are not decoded by it."""
_SCAN = b"\xff\xda"
"""JPEG's marker of a scan."""
_TILE = (322, 323)
"""TIFF's tags of a tile's size, which may be larger than the image."""

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
    size = _size(content)
    if size is None:
        return None
    budget.check_pixels(path, *size)
    if content.startswith(_PNG):
        _check_png_chunks(path, content)
    if content.startswith(_JPEG):
        scans = content.count(_SCAN)
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


def _size(content: bytes) -> tuple[int, int] | None:
    """Width and height [px] that an image's header claims; None for what is no image of a known format."""
    kind = next((kind for start, kind in _HEADERS.items() if content.startswith(start)), None)
    if kind is None:
        return None
    try:
        with kind(BytesIO(content)) as image:
            tags = image.tag_v2 if isinstance(image, TiffImageFile) else {}
            width, height = (max(side, int(tags.get(tag, 0))) for side, tag in zip(image.size, _TILE, strict=True))
            return width, height
    except Exception:  # of a damaged header, Pillow raises whatever it comes across
        return None


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
