"""Scenes of objects: their faces, their tags, and the sheets to print these from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tossid.errors import ObjectError
from tossid.objects import ObjectModel
from tossid.vision.setup.faces import default_tags, object_faces, tag_corners
from tossid.vision.setup.layout import TagLayout, articulated, chain, descendants, layout_of, object_tags
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


@pytest.fixture(scope="module")
def tagged_elbow(elbow: ObjectModel) -> ObjectModel:
    return elbow.with_changes(tags=default_tags(elbow))


def test_the_bodies_of_an_object_hang_together(tagged_elbow: ObjectModel) -> None:
    layout = articulated(layout_of(tagged_elbow), tagged_elbow)
    names = [body.name for body in layout.bodies]
    assert chain(layout.bodies, names.index("elbow_2")) == (names.index("elbow_1"), [names.index("elbow_2")])
    assert descendants(layout.bodies, names.index("elbow_1")) == [names.index("elbow_2")]
    with pytest.raises(ObjectError, match="elbow_2"):
        articulated(TagLayout(layout_of(tagged_elbow).bodies[:-1]), tagged_elbow)


def test_default_tags_are_the_published_cubes(tagged: ObjectModel):
    assert [tag.id for tag in tagged.tags] == [0, 1, 2, 3, 4, 5]
    for tag, face in zip(tagged.tags, object_faces(tagged), strict=True):
        assert tag.size == pytest.approx(0.08)
        np.testing.assert_allclose(tag.T_body_tag[:3, 3], 0.0524 * face.normal, atol=1e-12)
        np.testing.assert_allclose(tag.T_body_tag[:3, 2], face.normal, atol=1e-12)
        assert np.linalg.det(tag.T_body_tag[:3, :3]) == pytest.approx(1.0)


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
