"""Learned geometry is drawn with the shifts and the factor that it states; films show what is predicted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from PIL import Image

from tests.evaluation.figures.reading import assert_legible, line, titled, words
from tossid.errors import InputError
from tossid.evaluation.figures import films, geometry_at_angles, hull_film, learned_geometry, save_film, toss_film
from tossid.evaluation.figures.films import rgb
from tossid.evaluation.figures.geometry import UNSEEN, exaggeration
from tossid.evaluation.figures.style import MUTED
from tossid.evaluation.figures.wireframe import view_from, wireframe
from tossid.objects import ObjectModel, corner_positions
from tossid.types import Toss


def test_a_cube_has_twelve_edges_and_nine_are_seen_from_a_view_that_keeps_up_and_right(cube: ObjectModel) -> None:
    frame = wireframe(cube.corner_pos)
    lengths = np.linalg.norm(np.diff(cube.corner_pos[frame.edges], axis=1)[:, 0], axis=1)
    np.testing.assert_allclose(lengths, np.full(12, 0.1048))
    assert frame.visible(np.array([1.0, 0, 0, 0]), view_from(0.5, 0.4).toward).sum() == 9
    assert len(wireframe(cube.corner_pos[:3]).edges) == 3, "a flat body is drawn all the same"
    front = view_from(-np.pi / 2, 0.0)
    np.testing.assert_allclose(front(np.eye(3)), [[1, 0], [0, 0], [0, 1]], atol=1e-12)
    np.testing.assert_allclose(front.toward, [0, -1, 0], atol=1e-12)


def test_shifts_and_ways_of_corners_are_drawn_at_a_round_factor(cube: ObjectModel) -> None:
    shift, step = np.zeros((8, 3)), np.array([1e-3, 0, 0])
    shift[0] = step
    learned = cube.with_changes(corner_pos=cube.corner_pos + shift, com=cube.com + np.array([0, 0, 0.5e-3]))
    stages = [cube.corner_pos + 2 * step, cube.corner_pos + step, learned.corner_pos]
    figure = learned_geometry(cube, learned, stages=stages)
    above, front = titled(figure, "from above"), titled(figure, "from the front")
    moved = np.column_stack(line(above, "learned corners").get_data()) - 1e3 * cube.corner_pos[:, :2]
    np.testing.assert_allclose(moved, 5e3 * shift[:, :2], atol=1e-9)
    assert line(front, "learned com").get_ydata()[0] == pytest.approx(2.5 + 1e3 * cube.com[0, 2])
    assert line(front, "given com").get_ydata()[0] == pytest.approx(1e3 * cube.com[0, 2])
    assert "drawn 5 times" in words(figure)
    assert "at most 1.0 mm; centre of mass 0.50 mm" in words(figure)
    began = np.column_stack(line(above, "start").get_data())
    np.testing.assert_allclose(began, 1e3 * cube.corner_pos[:, :2] + [10, 0], atol=1e-9)
    (paths,) = [c for c in above.collections if c.get_label() == "path"]
    assert isinstance(paths, LineCollection)
    np.testing.assert_allclose(np.asarray(paths.get_segments()[1]) - began[1], [[0, 0], [-5, 0], [-10, 0]], atol=1e-9)
    assert_legible(figure)


def test_each_angle_shows_both_objects_and_what_touched(elbow: ObjectModel) -> None:
    learned = elbow.with_changes(corner_pos=elbow.corner_pos + np.array([0.001, 0, 0]))
    seen = np.arange(16) != 5
    figure = geometry_at_angles(elbow, learned, seen=seen)
    assert [ax.get_title(loc="left") for ax in figure.axes[:3]] == ["-115°", "-57°", "0°"]
    for ax in figure.axes[:3]:
        drawn = {"touched": 0, "unseen": 0}
        for one in ax.lines:
            drawn[str(one.get_label())] += len(one.get_xdata())
        assert drawn == {"touched": 15, "unseen": 1}
    assert "15 of 16 corners touched the ground: at most 1" in words(figure)
    with pytest.raises(InputError):
        geometry_at_angles(elbow, learned, seen=seen[:4])


def test_the_factor_is_round_and_a_link_has_a_row_beside_its_truth(cube: ObjectModel, elbow: ObjectModel) -> None:
    for size, factor in ((1e-3, 10.0), (1e-5, 100.0), (30e-3, 1.0), (0.0, 1.0)):
        assert exaggeration(cube, cube.with_changes(corner_pos=cube.corner_pos + np.array([size, 0, 0]))) == factor
    rng = np.random.default_rng(0)
    learned = elbow.with_changes(corner_pos=elbow.corner_pos + 1e-3 * rng.normal(size=elbow.corner_pos.shape))
    figure = learned_geometry(elbow, learned, truth=elbow)
    assert len(figure.axes) == 4 * elbow.n_bodies
    for ax in figure.axes:
        drawn = {c.get_label(): len(c.get_segments()) for c in ax.collections if isinstance(c, LineCollection)}
        assert drawn == {"given": 12, "truth": 12, "learned": 12}
    assert_legible(figure)


# ---------------------------------------------------------------- films


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
