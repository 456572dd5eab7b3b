"""A film shows the predicted object where it is predicted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tossid.errors import InputError
from tossid.evaluation.figures import toss_film
from tossid.objects import ObjectModel
from tossid.settings.figures import FigureSettings
from tossid.types import Toss


def test_a_film_s_predicted_object_is_where_it_is_predicted(elbow: ObjectModel) -> None:
    n = 9
    q = np.zeros((n, 8))
    q[:, 2], q[:, 3] = np.linspace(0.4, 0.1, n), 1.0
    cov = np.tile(1e-6 * np.eye(7), (n, 1, 1))
    toss = Toss("a", np.arange(n) / 148, q, np.zeros((n, 7)), cov, cov, np.zeros(n, dtype=np.uint8))
    same = toss_film(toss, replace(toss), elbow, name="cnrp", settings=FigureSettings(film_stride=4))
    assert same.shape[0] == 3
    apart = toss.q.copy()
    apart[:, 0] += 0.2
    other = toss_film(toss, replace(toss, q=apart), elbow, name="cnrp", settings=FigureSettings(film_stride=4))
    dark = lambda frames: (frames[:, 40:].max(axis=-1) < 90).sum(axis=(1, 2))  # noqa: E731
    assert (dark(same) == 0).all()  # hidden under the prediction
    assert (dark(other) > 50).all()
    with pytest.raises(InputError):
        toss_film(toss, replace(toss.frames(slice(0, 5))), elbow, name="cnrp")
