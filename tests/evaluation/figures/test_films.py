"""Films show the predicted object where it is predicted, and what tosses have cut away around an unknown one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tossid.errors import InputError
from tossid.evaluation.figures import films, hull_film, save_film, toss_film
from tossid.evaluation.figures.films import rgb
from tossid.evaluation.figures.geometry import UNSEEN
from tossid.evaluation.figures.style import MUTED
from tossid.objects import ObjectModel, corner_positions
from tossid.types import Toss


def toss_of(name: str, q: np.ndarray) -> Toss:
    n, nv = len(q), q.shape[1] - 1
    cov, phase = np.tile(1e-6 * np.eye(nv), (n, 1, 1)), np.zeros(n, dtype=np.uint8)
    return Toss(name, np.arange(n) / 148, q, np.zeros((n, nv)), cov, cov, phase)


def test_a_film_s_predicted_object_is_where_it_is_predicted(elbow: ObjectModel) -> None:
    q = np.zeros((9, 8))
    q[:, 2], q[:, 3] = np.linspace(0.4, 0.1, 9), 1.0
    toss, apart = toss_of("a", q), q.copy()
    apart[:, 0] += 0.2
    same = toss_film(toss, replace(toss), elbow, name="cnrp")
    other = toss_film(toss, replace(toss, q=apart), elbow, name="cnrp")
    dark = lambda frames: (frames[:, 40:].max(axis=-1) < 90).sum(axis=(1, 2))  # noqa: E731
    assert (dark(same) == 0).all()  # hidden under the prediction
    assert (dark(other) > 50).all()
    with pytest.raises(InputError):
        toss_film(toss, replace(toss.frames(slice(0, 5))), elbow, name="cnrp")


def test_tosses_cut_the_space_down_to_the_object(
    cube: ObjectModel, elbow: ObjectModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of forty tosses of five frames each, in all of which the cube touches the ground."""
    monkeypatch.setattr(films, "HULL_PICTURES", 6)
    rng, tosses = np.random.default_rng(3), []
    for number in range(40):
        q = np.concatenate([np.zeros((5, 3)), rng.normal(size=(5, 4))], axis=1)
        q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1, keepdims=True)
        q[:, 2] = -corner_positions(cube, q)[..., 2].min(axis=1)
        tosses.append(toss_of(f"{number}", q))
    film = hull_film(tosses, cube)
    # columns over which the grey hull reaches, below the caption
    grey = [(np.abs(frame[30:].astype(int) - rgb(MUTED)).max(axis=-1) < 12).any(axis=0) for frame in film]
    first, last = (np.ptp(np.flatnonzero(each)) if each.any() else 0 for each in (grey[0], grey[-1]))
    assert first > 1.5 * last
    crossed = [(frame == rgb(UNSEEN)).all(axis=-1).sum() for frame in film]
    assert crossed[0] > 0
    assert crossed[-1] == 0  # forty tosses have shown all corners
    path = save_film(film, tmp_path / "hull.gif", frame_ms=300)
    with Image.open(path) as written:
        assert (written.n_frames, written.size) == (len(film), (480, 360))
    with pytest.raises(InputError, match="one rigid body"):
        hull_film(tosses[:1], elbow)
