"""The bodies and tags of a scene belong to an object."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tossid.errors import ObjectError
from tossid.objects import ObjectModel
from tossid.vision.setup.faces import default_tags, tag_corners
from tossid.vision.setup.layout import TagLayout, articulated, chain, descendants, layout_of, object_tags
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
