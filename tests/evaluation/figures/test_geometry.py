"""Learned geometry is drawn with the shifts and the factor that it states, from the side that a view is on."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.collections import LineCollection

from tests.evaluation.figures.reading import assert_legible, line, titled, words
from tossid.errors import InputError
from tossid.evaluation.figures import geometry_at_angles, learned_geometry
from tossid.evaluation.figures.geometry import exaggeration
from tossid.evaluation.figures.wireframe import view_from, wireframe
from tossid.objects import ObjectModel


def test_a_cube_has_twelve_edges_and_nine_are_seen_from_a_view_that_keeps_up_and_right(cube: ObjectModel) -> None:
    frame = wireframe(cube.corner_pos)
    lengths = np.linalg.norm(np.diff(cube.corner_pos[frame.edges], axis=1)[:, 0], axis=1)
    np.testing.assert_allclose(lengths, np.full(12, 0.1048))
    assert frame.visible(np.array([1.0, 0, 0, 0]), view_from(0.5, 0.4).toward).sum() == 9
    assert len(wireframe(cube.corner_pos[:3]).edges) == 3, "a flat body is drawn all the same"
    front = view_from(-np.pi / 2, 0.0)
    np.testing.assert_allclose(front(np.eye(3)), [[1, 0], [0, 0], [0, 1]], atol=1e-12)
    np.testing.assert_allclose(front.toward, [0, -1, 0], atol=1e-12)


def test_shifts_and_ways_of_corners_are_drawn_at_the_stated_factor(cube: ObjectModel) -> None:
    shift, step = np.zeros((8, 3)), np.array([1e-3, 0, 0])
    shift[0] = step
    learned = cube.with_changes(corner_pos=cube.corner_pos + shift, com=cube.com + np.array([0, 0, 0.5e-3]))
    stages = [cube.corner_pos + 2 * step, cube.corner_pos + step, learned.corner_pos]
    figure = learned_geometry(cube, learned, factor=10, stages=stages)
    above, front = titled(figure, "from above"), titled(figure, "from the front")
    moved = np.column_stack(line(above, "learned corners").get_data()) - 1e3 * cube.corner_pos[:, :2]
    np.testing.assert_allclose(moved, 1e4 * shift[:, :2], atol=1e-9)
    assert line(front, "learned com").get_ydata()[0] == pytest.approx(5 + 1e3 * cube.com[0, 2])
    assert line(front, "given com").get_ydata()[0] == pytest.approx(1e3 * cube.com[0, 2])
    assert "drawn 10 times" in words(figure)
    assert "at most 1.0 mm; centre of mass 0.50 mm" in words(figure)
    began = np.column_stack(line(above, "start").get_data())
    np.testing.assert_allclose(began, 1e3 * cube.corner_pos[:, :2] + [20, 0], atol=1e-9)
    (paths,) = [c for c in above.collections if c.get_label() == "path"]
    assert isinstance(paths, LineCollection)
    np.testing.assert_allclose(np.asarray(paths.get_segments()[1]) - began[1], [[0, 0], [-10, 0], [-20, 0]], atol=1e-9)
    assert_legible(figure)


def test_the_factor_is_round_and_fits(cube: ObjectModel) -> None:
    for size, factor in ((1e-3, 10.0), (1e-5, 100.0), (30e-3, 1.0), (0.0, 1.0)):
        learned = cube.with_changes(corner_pos=cube.corner_pos + np.array([size, 0, 0]))
        assert exaggeration(cube, learned) == factor
    assert exaggeration(cube, cube, stages=[cube.corner_pos + np.array([2e-3, 0, 0])]) == 5.0


def test_geometry_has_a_row_a_link_and_shows_the_truth(elbow: ObjectModel) -> None:
    rng = np.random.default_rng(0)
    learned = elbow.with_changes(corner_pos=elbow.corner_pos + 1e-3 * rng.normal(size=elbow.corner_pos.shape))
    figure = learned_geometry(elbow, learned, truth=elbow)
    assert len(figure.axes) == 4 * elbow.n_bodies
    for ax in figure.axes:
        drawn = {c.get_label(): len(c.get_segments()) for c in ax.collections if isinstance(c, LineCollection)}
        assert drawn == {"given": 12, "truth": 12, "learned": 12}
    assert_legible(figure)


def test_where_the_object_may_reach_is_marked_and_in_the_picture(cube: ObjectModel) -> None:
    figure = learned_geometry(cube, cube, unseen=np.array([[0.09, 0.05, 0.05], [0.05, 0.09, 0.05]]))
    above = titled(figure, "from above")
    np.testing.assert_allclose(np.column_stack(line(above, "may reach").get_data()), [[90, 50], [50, 90]], atol=1e-9)
    assert above.get_xlim()[1] > 90
    assert_legible(figure)


def test_one_corner_that_nobody_saw_does_not_shrink_the_object(cube: ObjectModel) -> None:
    seen = np.arange(8) != 3
    start = cube.corner_pos.copy()
    start[3] += 0.5
    plain = learned_geometry(cube, cube)
    figure = learned_geometry(
        cube, cube, seen=seen, stages=[start, cube.corner_pos], unseen=np.array([[0.9, 0.1, 0.1], [0.06, 0.06, 0.06]])
    )
    wide, usual = (float(np.ptp(titled(each, "from above").get_xlim())) for each in (figure, plain))
    assert usual < wide < 1.5 * usual
    assert "It may reach 900 mm from the middle, beyond the picture." in words(figure)
    assert_legible(figure)


def test_each_angle_shows_both_objects_and_what_touched(elbow: ObjectModel) -> None:
    learned = elbow.with_changes(corner_pos=elbow.corner_pos + np.array([0.001, 0, 0]))
    seen = np.arange(16) != 5
    figure = geometry_at_angles(elbow, learned, seen=seen, angles=(0.0, 0.5, 1.0))
    assert [ax.get_title(loc="left") for ax in figure.axes[:3]] == ["0°", "29°", "57°"]
    for ax in figure.axes[:3]:
        drawn = {"touched": 0, "unseen": 0}
        for one in ax.lines:
            drawn[str(one.get_label())] += len(one.get_xdata())
        assert drawn == {"touched": 15, "unseen": 1}
    assert "15 of 16 corners touched the ground: at most 1" in words(figure)
    with pytest.raises(InputError):
        geometry_at_angles(elbow, learned, seen=seen[:4])
