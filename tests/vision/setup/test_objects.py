"""Scenes of objects: their faces, tags and hinges, and the sheets to print tags from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tossid.errors import ObjectError
from tossid.objects import ObjectModel, body_poses
from tossid.rotations import quat_normalize, transform, transform_inv
from tossid.vision.setup.faces import tag_corners
from tossid.vision.setup.hinge import stacked, swing
from tossid.vision.setup.layout import articulated, layout_of, object_tags
from tossid.vision.setup.tag_sheet import PAPERS, tag_sheets
from tossid.vision.setup.tagslam import read_tagslam, write_tagslam


def test_an_objects_tags_survive_the_layout_file(tmp_path: Path, tagged: ObjectModel):
    write_tagslam(layout_of(tagged), tmp_path / "tagslam.yaml")
    again = object_tags(read_tagslam(tmp_path / "tagslam.yaml"), tagged.body_names)
    assert [tag.id for tag in again] == list(range(6))
    for read, tag in zip(again, tagged.tags, strict=True):
        np.testing.assert_allclose(tag_corners(read), tag_corners(tag), atol=1e-12)
    # a one-body object takes the only moving body, whatever its name; a two-body object does not
    assert len(object_tags(read_tagslam(tmp_path / "tagslam.yaml"), ["box"])) == 6
    with pytest.raises(ObjectError, match="cube"):
        object_tags(read_tagslam(tmp_path / "tagslam.yaml"), ["box", "lid"])


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


def test_a_hinge_is_the_objects_own(elbow: ObjectModel) -> None:
    rng, hinge = np.random.default_rng(0), articulated(layout_of(elbow), elbow).bodies[-1].hinge
    for angle in rng.uniform(-3, 3, 20):
        q = np.array([*rng.normal(size=3), *quat_normalize(rng.normal(size=4)), angle])
        base, limb = (transform(p, quat) for p, quat in zip(*body_poses(elbow, q), strict=True))
        np.testing.assert_allclose(swing(base, *stacked([hinge]), np.array([angle]))[0], limb, atol=1e-12)
        assert hinge.angle(transform_inv(base) @ limb) == pytest.approx(angle, abs=1e-12)
        assert hinge.misfit(transform_inv(base) @ limb) == pytest.approx(0.0, abs=1e-9)
        flipped = limb @ transform(np.zeros(3), np.array([0.0, 1.0, 0.0, 0.0]))
        assert hinge.misfit(transform_inv(base) @ flipped) > 100
