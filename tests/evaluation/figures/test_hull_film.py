"""A film shows what tosses have cut away of the space around an object."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tossid.errors import InputError
from tossid.evaluation.figures import hull_film, save_film
from tossid.evaluation.figures.film import rgb
from tossid.evaluation.figures.geometry import UNSEEN
from tossid.evaluation.figures.style import MUTED
from tossid.objects import ObjectModel, corner_positions
from tossid.settings.figures import FigureSettings
from tossid.types import Toss


def touching(cube: ObjectModel, count: int) -> list[Toss]:
    """Tosses of five frames each, in all of which the cube touches the ground."""
    rng, found = np.random.default_rng(3), []
    cov, phase = np.zeros((5, 6, 6)), np.zeros(5, dtype=np.uint8)
    for number in range(count):
        q = np.zeros((5, 7))
        q[:, 3:] = rng.normal(size=(5, 4))
        q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1, keepdims=True)
        q[:, 2] = -corner_positions(cube, q)[..., 2].min(axis=1)
        found.append(Toss(f"{number}", np.arange(5) / 148, q, np.zeros((5, 6)), cov, cov, phase))
    return found


def grey_width(frame: np.ndarray) -> int:
    """Columns over which the grey hull reaches, below the caption."""
    grey = (np.abs(frame[30:].astype(int) - rgb(MUTED)).max(axis=-1) < 12).any(axis=0)
    columns = np.flatnonzero(grey)
    return int(np.ptp(columns)) if len(columns) else 0


def test_tosses_cut_the_space_down_to_the_object(cube: ObjectModel, tmp_path: Path) -> None:
    tosses = touching(cube, 40)
    film = hull_film(tosses, cube, settings=FigureSettings(hull_pictures=6))
    assert film.shape[1:] == (360, 480, 3)
    assert grey_width(film[0]) > 1.5 * grey_width(film[-1])
    crossed = [(frame == rgb(UNSEEN)).all(axis=-1).sum() for frame in film]
    assert crossed[0] > 0
    assert crossed[-1] == 0  # forty tosses have shown all corners
    path = save_film(film, tmp_path / "hull.gif", frame_ms=300)
    with Image.open(path) as written:
        assert (written.n_frames, written.size) == (len(film), (480, 360))


def test_objects_with_joints_are_refused(cube: ObjectModel, elbow: ObjectModel) -> None:
    with pytest.raises(InputError, match="one rigid body"):
        hull_film(touching(cube, 1), elbow)
