"""A contact sheet shows each picture around its tags, and says below what was found."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.errors import InputError
from tossid.types import Detection
from tossid.vision.detection.contact_sheet import FOUND, GAP, HEAD, Cell, Column, caption, contact_sheet

SQUARE = np.array([[200.0, 130.0], [230.0, 130.0], [230.0, 100.0], [200.0, 100.0]])


def _tag(tag_id: int) -> Detection:
    return Detection("cam0", 1.0, tag_id, SQUARE, np.zeros((4, 2, 2)))


def test_captions_say_what_was_found() -> None:
    image = np.zeros((240, 320), dtype=np.uint8)
    assert caption(Cell("cam0", 1.0, None)) == "cam0: no frame"
    assert caption(Cell("cam0", 1.0, image)) == "cam0: no tag found"
    assert caption(Cell("cam0", 1.0, image, (_tag(4), _tag(2)))) == "cam0: tags 2, 4; no pose"
    assert caption(Cell("cam0", 1.0, image, (_tag(4),), (SQUARE,), 0.34)) == "cam0: tag 4; off by 0.34 px"


def test_a_picture_is_centred_on_its_tags() -> None:
    image = np.full((240, 320), 128, dtype=np.uint8)
    sheet = contact_sheet([Column(1.0, "release", (Cell("cam0", 1.0, image, (_tag(4),)),))], title="film", width=300)
    picture = sheet[HEAD : HEAD + 240, GAP : GAP + 300].astype(int)
    green = np.abs(picture - FOUND).sum(axis=-1) < 60
    rows, columns = np.nonzero(green)
    assert green.sum() > 100
    assert abs(0.5 * (columns.min() + columns.max()) - 150) < 3
    assert abs(0.5 * (rows.min() + rows.max()) - 120) < 3


def test_nothing_to_draw_is_refused() -> None:
    with pytest.raises(InputError, match="no frames"):
        contact_sheet([], title="film")
