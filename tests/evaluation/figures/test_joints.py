"""Figures and films of objects with joints show what they are given."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tossid.errors import InputError
from tossid.evaluation.figures import geometry_at_angles, toss_film
from tossid.objects import ObjectModel
from tossid.types import Toss


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


def test_a_film_s_predicted_object_is_where_it_is_predicted(elbow: ObjectModel) -> None:
    n = 9
    q = np.zeros((n, 8))
    q[:, 2], q[:, 3] = np.linspace(0.4, 0.1, n), 1.0
    cov = np.tile(1e-6 * np.eye(7), (n, 1, 1))
    toss = Toss("a", np.arange(n) / 148, q, np.zeros((n, 7)), cov, cov, np.zeros(n, dtype=np.uint8))
    same = toss_film(toss, replace(toss), elbow, name="cnrp", every=4)
    assert same.shape[0] == 3
    apart = toss.q.copy()
    apart[:, 0] += 0.2
    other = toss_film(toss, replace(toss, q=apart), elbow, name="cnrp", every=4)
    dark = lambda frames: (frames[:, 40:].max(axis=-1) < 90).sum(axis=(1, 2))  # noqa: E731
    assert (dark(same) == 0).all()  # hidden under the prediction
    assert (dark(other) > 50).all()
    with pytest.raises(InputError):
        toss_film(toss, replace(toss.frames(slice(0, 5))), elbow, name="cnrp")
