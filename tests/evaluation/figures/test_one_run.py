"""Figures of one run or one toss show the numbers that they were given."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from matplotlib.collections import LineCollection

from tests.evaluation.figures.reading import assert_legible, line, lines, titled, words
from tossid.errors import InputError
from tossid.evaluation.figures import learned_geometry, residual_over_toss, toss_comparison, training_curves
from tossid.evaluation.figures.comparison import pose_frames
from tossid.evaluation.figures.geometry import exaggeration
from tossid.evaluation.figures.wireframe import view_from, wireframe
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp
from tossid.types import Phase, Rollout, Toss


@dataclass
class Record:
    stage: str
    train_loss: float
    validation_loss: float
    parts: dict[str, float] = field(default_factory=dict)


def history() -> list[Record]:
    out = []
    for stage, n in (("continuous", 5), ("contact", 8)):
        for e in range(n):
            loss = 0.01 * 2.0**-e
            validation = loss * (3 if e == n - 1 else 1.5)
            parts = {"prediction": 0.7 * loss, "penetration": 0.3 * loss, "residual": 0.0, "unsolved": float(e == 2)}
            out.append(Record(stage, loss, validation, parts))
    return out


def test_training_curves_show_every_epoch_and_mark_stages() -> None:
    records = history()
    figure = training_curves(records)
    loss, parts = titled(figure, "Loss"), titled(figure, "Parts")
    for label, key in (("training", "train_loss"), ("validation", "validation_loss")):
        drawn = np.concatenate([one.get_ydata() for one in lines(loss, label)])
        np.testing.assert_allclose(drawn, [getattr(record, key) for record in records])
        assert len(lines(loss, label)) == 2, "stages are not joined"
    drawn = np.concatenate([one.get_ydata() for one in lines(parts, "prediction")])
    np.testing.assert_allclose(drawn, [record.parts["prediction"] for record in records])
    # the kept epochs are those of the lowest validation loss: the last but one of each stage
    assert [one.get_xdata()[0] for one in lines(loss, "_kept")] == [4, 12]
    assert {text.get_text().strip() for text in loss.texts} >= {"continuous", "contact", "training", "validation"}
    assert not lines(parts, "unsolved"), "a count is no part of the loss"
    assert "Unsolved inner problems: at most 1" in words(figure)
    assert_legible(figure)


@pytest.mark.parametrize("n", [1, 2])
def test_training_curves_of_a_short_fit(n: int) -> None:
    assert_legible(training_curves(history()[:n]))


def test_training_curves_need_an_epoch() -> None:
    with pytest.raises(InputError, match="no epochs"):
        training_curves([])


def test_a_cube_has_twelve_edges_and_nine_are_seen(cube: ObjectModel) -> None:
    frame = wireframe(cube.corner_pos)
    lengths = np.linalg.norm(np.diff(cube.corner_pos[frame.edges], axis=1)[:, 0], axis=1)
    np.testing.assert_allclose(lengths, np.full(12, 0.1048))
    identity = np.array([1.0, 0, 0, 0])
    assert frame.visible(identity, view_from(0.5, 0.4).toward).sum() == 9
    assert len(wireframe(cube.corner_pos[:3]).edges) == 3, "a flat body is drawn all the same"


def test_a_view_keeps_up_up_and_right_right() -> None:
    view = view_from(-np.pi / 2, 0.0)  # from the front
    np.testing.assert_allclose(view(np.eye(3)), [[1, 0], [0, 0], [0, 1]], atol=1e-12)
    np.testing.assert_allclose(view.toward, [0, -1, 0], atol=1e-12)


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


def toss_and_rollout(model: ObjectModel) -> tuple[Toss, Rollout]:
    """A fall, then a slide; the prediction is 10 mm ahead and turned by 20° about the vertical."""
    n = 60
    t = 0.3 + np.arange(n) / 148.0
    q = np.zeros((n, model.nq))
    q[:, 3] = 1
    q[:, 1] = np.linspace(0, 0.4, n)
    q[:, 2] = np.maximum(0.3 - 4.9 * (t - t[0]) ** 2, 0.0524)
    phase = np.where(np.arange(n) < 33, Phase.FLIGHT, Phase.SLIDE).astype(np.uint8)
    phase[33] = Phase.IMPACT
    cov = np.tile(np.eye(model.nv) * 1e-6, (n, 1, 1))
    toss = Toss("swift", t, q, np.zeros((n, model.nv)), cov, cov, phase)
    ahead = q.copy()
    ahead[:, 1] += 0.010
    ahead[:, 3:7] = quat_exp(np.array([0, 0, np.deg2rad(20)]))
    return toss, Rollout(t, ahead, toss.v, np.zeros((n, model.n_corners)))


@pytest.mark.parametrize("name", ["cube", "elbow"])
def test_a_toss_is_compared_frame_by_frame(name: str, request: pytest.FixtureRequest) -> None:
    model = request.getfixturevalue(name)
    toss, run = toss_and_rollout(model)
    figure = toss_comparison(toss, {"cn": run, "cnrpi": run}, model)
    axes = {ax.get_ylabel(): ax for ax in figure.axes if ax.axison}
    assert set(axes) == {"height [m]", "way along throw [m]", "position error [mm]", "rotation error [deg]"}
    time = toss.t - toss.t[0]
    np.testing.assert_allclose(line(axes["height [m]"], "measured").get_data(), [time, toss.q[:, 2]], atol=1e-12)
    way = line(axes["way along throw [m]"], "measured").get_ydata()
    np.testing.assert_allclose(way, toss.q[:, 1], atol=1e-9)
    np.testing.assert_allclose(line(axes["way along throw [m]"], "cn").get_ydata() - way, 0.010, atol=1e-9)
    np.testing.assert_allclose(line(axes["position error [mm]"], "cn").get_ydata(), 10, atol=1e-9)
    np.testing.assert_allclose(line(axes["rotation error [deg]"], "cnrpi").get_ydata(), 20, atol=1e-6)
    spans = {p.get_label(): p for p in axes["height [m]"].patches}
    assert set(spans) == {"_IMPACT", "_SLIDE"}
    assert spans["_IMPACT"].get_x() == pytest.approx(32.5 / 148)
    assert spans["_IMPACT"].get_width() == pytest.approx(1 / 148)
    windows = [ax for ax in figure.axes if not ax.axison]
    for window in windows:
        assert {c.get_label() for c in window.collections} == {"measured", "cn", "cnrpi"}
    assert [w.get_title() for w in windows] == [f"{time[k]:.2f} s" for k in pose_frames(toss, model, 7)]
    assert_legible(figure)


def test_a_rollout_of_other_frames_is_refused(cube: ObjectModel) -> None:
    toss, run = toss_and_rollout(cube)
    with pytest.raises(InputError, match="swift: cn predicts"):
        toss_comparison(toss, {"cn": Rollout(run.t[:9], run.q[:9], run.v[:9], run.lam_n[:9])}, cube)


def accelerations() -> dict[str, np.ndarray]:
    n = 80
    contact = np.where(np.arange(n) >= 50, 9.81, 0.0)
    contact[30] = 250.0
    given, residual = np.full(n, -4.0), np.full(n, -5.81)
    return {
        "t": np.arange(n) / 148,
        "given": given,
        "residual": residual,
        "contact": contact,
        "measured": given + residual + contact + 0.5,
        "separable": np.arange(n) < 50,
    }


def test_accelerations_add_up_and_what_is_not_separable_is_hatched() -> None:
    parts = accelerations()
    figure = residual_over_toss(parts["t"], **{k: v for k, v in parts.items() if k != "t"})
    given, residual, contact, total = figure.axes
    for ax, name in ((given, "given"), (residual, "residual"), (contact, "contact"), (total, "measured")):
        np.testing.assert_array_equal(line(ax, name).get_data(), [parts["t"], parts[name]])
    np.testing.assert_allclose(line(total, "sum").get_ydata(), parts["measured"] - 0.5)
    assert line(given, "true").get_ydata()[0] == -9.81
    for ax in figure.axes:
        (span,) = [p for p in ax.patches if p.get_hatch()]
        assert span.get_x() == pytest.approx(49.5 / 148)
        low, high = ax.get_ylim()
        drawn = np.concatenate([one.get_ydata() for one in ax.lines if len(one.get_ydata()) == 80])
        assert low < drawn.min() <= drawn.max() < high
    for ax in (residual, contact):
        assert "not separable" in [text.get_text() for text in ax.texts]
    assert "given −4.00, with the residual −9.81, measured −9.31" in words(figure)
    assert_legible(figure)


def test_nothing_is_hatched_where_all_is_separable() -> None:
    parts = accelerations()
    parts["separable"] = np.ones(80, dtype=bool)
    figure = residual_over_toss(parts["t"], **{k: v for k, v in parts.items() if k != "t"})
    assert not [p for ax in figure.axes for p in ax.patches if p.get_hatch()]
    assert "not separable" not in words(figure)


def test_accelerations_of_other_lengths_are_refused() -> None:
    parts = accelerations()
    with pytest.raises(InputError, match="contact has shape"):
        residual_over_toss(parts["t"], **{k: v[:5] if k == "contact" else v for k, v in parts.items() if k != "t"})
