"""Learned geometry is drawn with the shifts and the factor that it states."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.collections import LineCollection

from tests.evaluation.figures.reading import assert_legible, line, titled, words
from tossid.evaluation.figures import learned_geometry
from tossid.evaluation.figures.geometry import exaggeration
from tossid.objects import ObjectModel


def test_geometry_draws_shifts_at_the_stated_factor(cube: ObjectModel) -> None:
    shift = np.zeros((8, 3))
    shift[0] = [1e-3, 0, 0]
    learned = cube.with_changes(corner_pos=cube.corner_pos + shift, com=cube.com + np.array([0, 0, 0.5e-3]))
    figure = learned_geometry(cube, learned, factor=10)
    above, front = titled(figure, "from above"), titled(figure, "from the front")
    moved = np.column_stack(line(above, "learned corners").get_data()) - 1e3 * cube.corner_pos[:, :2]
    np.testing.assert_allclose(moved[0], [10, 0], atol=1e-9)
    np.testing.assert_allclose(moved[1:], 0, atol=1e-9)
    assert line(front, "learned com").get_ydata()[0] == pytest.approx(5 + 1e3 * cube.com[0, 2])
    assert line(front, "given com").get_ydata()[0] == pytest.approx(1e3 * cube.com[0, 2])
    assert "drawn 10 times" in words(figure)
    assert "at most 1.0 mm; centre of mass 0.50 mm" in words(figure)
    assert_legible(figure)


def test_geometry_has_a_row_a_link_and_shows_the_truth(elbow: ObjectModel) -> None:
    rng = np.random.default_rng(0)
    learned = elbow.with_changes(corner_pos=elbow.corner_pos + 1e-3 * rng.normal(size=elbow.corner_pos.shape))
    figure = learned_geometry(elbow, learned, truth=elbow)
    assert len(figure.axes) == 4 * elbow.n_bodies
    for ax in figure.axes:
        drawn = {c.get_label(): len(c.get_segments()) for c in ax.collections if isinstance(c, LineCollection)}
        assert drawn == {"given": 12, "truth": 12, "learned": 12}
    assert_legible(figure)


def test_the_factor_is_round_and_fits(cube: ObjectModel) -> None:
    for size, factor in ((1e-3, 10.0), (1e-5, 100.0), (30e-3, 1.0), (0.0, 1.0)):
        learned = cube.with_changes(corner_pos=cube.corner_pos + np.array([size, 0, 0]))
        assert exaggeration(cube, learned) == factor


def test_the_way_of_corners_is_drawn_at_the_same_factor(cube: ObjectModel) -> None:
    step = np.array([1e-3, 0, 0])
    start, between = cube.corner_pos + 2 * step, cube.corner_pos + step
    learned = cube.with_changes(corner_pos=cube.corner_pos + np.array([0, 1e-3, 0]))
    figure = learned_geometry(cube, learned, factor=10, way=[start, between, learned.corner_pos])
    above = titled(figure, "from above")
    began = np.column_stack(line(above, "start").get_data())
    np.testing.assert_allclose(began, 1e3 * cube.corner_pos[:, :2] + [20, 0], atol=1e-9)
    (paths,) = [c for c in above.collections if c.get_label() == "way"]
    assert isinstance(paths, LineCollection)
    np.testing.assert_allclose(np.asarray(paths.get_segments()[0]) - began[0], [[0, 0], [-10, 0], [-20, 10]], atol=1e-9)
    assert "start and way of a corner" in words(figure)
    assert exaggeration(cube, cube, way=[start]) == 5.0
    assert_legible(figure)


def test_where_the_object_may_reach_is_marked_and_in_the_picture(cube: ObjectModel) -> None:
    figure = learned_geometry(cube, cube, unseen=np.array([[0.09, 0.05, 0.05], [0.05, 0.09, 0.05]]))
    above = titled(figure, "from above")
    np.testing.assert_allclose(np.column_stack(line(above, "may reach").get_data()), [[90, 50], [50, 90]], atol=1e-9)
    assert above.get_xlim()[1] > 90
    assert "may reach here: never seen" in words(figure)
    assert_legible(figure)
