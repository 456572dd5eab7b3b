"""Tags and faces of an object: the published cube's, and what cannot be drawn."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.objects import ObjectModel
from tossid.vision.setup.faces import object_faces


def test_default_tags_are_the_published_cubes(tagged: ObjectModel):
    assert [tag.id for tag in tagged.tags] == [0, 1, 2, 3, 4, 5]
    for tag, face in zip(tagged.tags, object_faces(tagged), strict=True):
        assert tag.size == pytest.approx(0.08)
        np.testing.assert_allclose(tag.T_body_tag[:3, 3], 0.0524 * face.normal, atol=1e-12)
        np.testing.assert_allclose(tag.T_body_tag[:3, 2], face.normal, atol=1e-12)
        assert np.linalg.det(tag.T_body_tag[:3, :3]) == pytest.approx(1.0)
