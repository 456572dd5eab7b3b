"""Geometry at joint angles shows both objects and what touched the ground."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.errors import InputError
from tossid.evaluation.figures import geometry_at_angles
from tossid.objects import ObjectModel


def test_each_angle_shows_both_objects_and_what_touched(elbow: ObjectModel) -> None:
    learned = elbow.with_changes(corner_pos=elbow.corner_pos + np.array([0.001, 0, 0]))
    seen = np.arange(16) != 5
    figure = geometry_at_angles(elbow, learned, seen=seen, angles=(0.0, 0.5, 1.0))
    assert [ax.get_title(loc="left") for ax in figure.axes[:3]] == ["0°", "29°", "57°"]
    for ax in figure.axes[:3]:
        drawn = {"touched": 0, "unseen": 0}
        for line in ax.lines:
            drawn[str(line.get_label())] += len(line.get_xdata())
        assert drawn == {"touched": 15, "unseen": 1}
    texts = [text.get_text() for text in figure.texts]
    assert any("15 of 16 corners touched the ground: at most 1" in text for text in texts)
    with pytest.raises(InputError):
        geometry_at_angles(elbow, learned, seen=seen[:4])
