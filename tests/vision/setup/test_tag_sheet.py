"""Tags are drawn at true scale, each on the page, none over another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tossid.errors import ObjectError
from tossid.objects import ObjectModel
from tossid.vision.setup.tag_sheet import PAPERS, tag_sheets


@pytest.mark.parametrize("paper", sorted(PAPERS))
def test_every_tag_is_on_a_page_at_true_scale(tagged: ObjectModel, paper: str) -> None:
    pages = tag_sheets(tagged, paper=paper)
    boxes = []
    for number, page in enumerate(pages):
        assert tuple(25.4 * page.get_size_inches()) == pytest.approx(PAPERS[paper])
        for patch in page.axes[0].patches:
            if patch.get_facecolor()[:3] == (0.0, 0.0, 0.0):  # a tag's black border [mm]
                x, y, w, h = patch.get_bbox().bounds
                boxes.append((number, x, y, x + w, y + h))
                assert 0 < x < x + w < PAPERS[paper][0]
                assert 0 < y < y + h < PAPERS[paper][1]
    assert len(boxes) == len(tagged.tags)
    np.testing.assert_allclose([box[3] - box[1] for box in boxes], [1e3 * tag.size for tag in tagged.tags])
    for i, a in enumerate(boxes):
        for b in boxes[:i]:
            assert a[0] != b[0] or a[3] < b[1] or b[3] < a[1] or a[4] < b[2] or b[4] < a[2]


def test_a_tag_larger_than_the_paper_is_refused(tagged: ObjectModel) -> None:
    large = replace(tagged, tags=(replace(tagged.tags[0], size=0.3),))
    with pytest.raises(ObjectError, match="300 mm does not fit on a4"):
        tag_sheets(large)
