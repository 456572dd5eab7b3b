"""Tosses beside their predictions: errors over tosses, along rollouts and frame by frame; witnesses in their order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import norm

from tests.evaluation.figures.motions import toss_and_rollout
from tests.evaluation.figures.reading import assert_legible, bars, line, titled, words
from tossid.errors import InputError
from tossid.evaluation.accelerations import Accelerations
from tossid.evaluation.figures import (
    ErrorsAlong,
    errors_along,
    errors_along_rollout,
    errors_over_tosses,
    recording_over_order,
    residual_over_toss,
    toss_comparison,
)
from tossid.evaluation.figures.toss import pose_frames
from tossid.evaluation.figures.tosses import mean_band
from tossid.evaluation.metrics import summarize
from tossid.motion import frames_in_flight
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp
from tossid.types import RecordingOrder, Rollout, Session


@dataclass
class Errors:
    position_error_pct: np.ndarray
    rotation_error_deg: np.ndarray


def scores(n: int, *, seed: int) -> Errors:
    rng = np.random.default_rng(seed)
    return Errors(rng.gamma(4, 4, n), rng.gamma(4, 3, n))


def test_every_toss_is_a_dot_and_intervals_are_those_of_the_metrics() -> None:
    given = {name: scores(100, seed=i) for i, name in enumerate(("cn", "cnrp", "cnrpi", "e2e", "diffsim"))}
    given["cn"].position_error_pct[[17, 56]] = 120.0, 90.0
    names = [f"demo_{i:03d}" for i in range(100)]
    figure = errors_over_tosses(given, names)
    for title, kind in (("Position", "position_error_pct"), ("Rotation", "rotation_error_deg")):
        ax = titled(figure, title)
        for i, (name, one) in enumerate(given.items()):
            dots = line(ax, name)
            np.testing.assert_array_equal(dots.get_ydata(), getattr(one, kind))
            assert np.abs(dots.get_xdata() - i).max() < 0.2
            summary = summarize(getattr(one, kind))
            low, high = bars(ax, f"{name} mean")
            assert [low[0], high[0]] == pytest.approx(summary["ci95"])
    texts = [text.get_text() for text in titled(figure, "Position").texts]
    assert {"demo_017", "demo_056"} <= set(texts)
    assert "demo_000" not in texts
    assert_legible(figure)
    same = Errors(np.full(9, 5.0), np.full(9, 5.0))
    dots = line(titled(errors_over_tosses({"cn": same}, list("abcdefghi")), "Position"), "cn")
    assert len(np.unique(dots.get_xdata())) == 9, "dots of equal errors lie side by side"


def test_errors_are_lined_up_at_first_contact(cube: ObjectModel) -> None:
    toss, run = toss_and_rollout(cube)
    later = toss.frames(slice(9, None))
    short = Rollout(run.t[9:], run.q[9:], run.v[9:], run.lam_n[9:])
    along = errors_along([toss, later], [run, short], cube)
    assert along.position_error_pct.shape == (2, len(toss))
    first = frames_in_flight([toss], cube)[0]
    np.testing.assert_allclose(along.time, toss.t - toss.t[first], atol=1e-9)
    np.testing.assert_allclose(along.position_error_pct[0], 100 * 0.010 / 0.1048)
    np.testing.assert_allclose(along.rotation_error_deg[0], 20)
    assert np.isnan(along.position_error_pct[1, :8]).all()
    np.testing.assert_allclose(along.position_error_pct[1, 9:], 100 * 0.010 / 0.1048)


def test_the_band_covers_the_true_mean_95_times_in_100() -> None:
    values = norm.rvs(size=(12, 4000), random_state=np.random.default_rng(0))
    _, low, high = mean_band(values)
    assert np.mean((low < 0) & (high > 0)) == pytest.approx(0.95, abs=0.012)
    values[:, 0] = np.nan
    values[3, 0] = 1.0
    assert np.isnan(mean_band(values)[0][0]), "one toss has no interval"


def test_curves_are_means_and_bands_are_their_intervals() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(-20, 80) / 148
    given = {
        name: ErrorsAlong(time, rng.gamma(4, 2, (30, 100)), rng.gamma(4, 3, (30, 100))) for name in ("cn", "cnrpi")
    }
    for one in given.values():
        one.position_error_pct[:25, 70:] = np.nan
        one.rotation_error_deg[:25, 70:] = np.nan
    figure = errors_along_rollout(given)
    position, rotation, count = figure.axes
    for ax, kind in ((position, "position_error_pct"), (rotation, "rotation_error_deg")):
        for name, one in given.items():
            mean, low, high = mean_band(getattr(one, kind))
            drawn = line(ax, name).get_ydata()
            np.testing.assert_allclose(drawn[:70], mean[:70])
            assert np.isnan(drawn[70:]).all(), "5 of 30 tosses are too few"
            (band,) = [c for c in ax.collections if c.get_label() == f"{name} band"]
            corners = band.get_paths()[0].vertices
            assert corners[:, 1].max() == pytest.approx(high[:70].max())
            assert corners[:, 1].min() == pytest.approx(low[:70].min())
    np.testing.assert_array_equal(line(count, "cn").get_ydata()[:70], 30)
    assert_legible(figure)


def test_each_witness_is_drawn_over_order_and_place_with_its_sessions() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(size=(6, 3))
    values[2, 1] = np.nan
    order = RecordingOrder(
        (Session("a", "c", 3, (0.04, -0.02), (0.001, 0.002), levelled=True), Session("d", "f", 3)),
        "times",
        tuple("abcdef"),
        ("fall_x", "fall_y", "height"),
        values,
        rng.normal(size=(6, 2)),
        quat_exp(0.1 * rng.normal(size=(6, 3))),
        rng.normal(size=6),
        np.repeat([0, 1], 3),
    )
    figure = recording_over_order(order)
    first = {ax.get_ylabel(): ax for ax in figure.axes if ax.get_ylabel()}
    np.testing.assert_allclose(first["fall [°]"].lines[1].get_ydata(), np.rad2deg(values[:, 1]))
    np.testing.assert_allclose(first["resting height [mm]"].lines[0].get_ydata(), 1e3 * values[:, 2])
    assert first["fall [°]"].lines[-1].get_xdata()[0] == 2.5, "where the second session begins"
    assert "2 sessions" in words(figure)


def test_what_is_not_finite_is_counted_and_what_explodes_does_not_squash_the_rest() -> None:
    given = {"cn": scores(30, seed=0), "e2e": scores(30, seed=1)}
    given["e2e"].position_error_pct[[3, 4]] = np.inf, 1e5
    names = [str(i) for i in range(30)]
    figure = errors_over_tosses(given, names)
    assert len(line(titled(figure, "Position"), "e2e").get_ydata()) == 29
    assert "left out: 1 values" in words(figure)
    assert [titled(figure, name).get_yscale() for name in ("Position", "Rotation")] == ["log", "linear"]
    with pytest.raises(InputError, match="cn has scores of 30 tosses, there are 29 names"):
        errors_over_tosses(given, names[1:])


@pytest.mark.parametrize("name", ["cube", "elbow"])
def test_a_toss_is_compared_frame_by_frame(name: str, request: pytest.FixtureRequest) -> None:
    model = request.getfixturevalue(name)
    toss, run = toss_and_rollout(model)
    figure = toss_comparison(toss, {"cn": run, "cnrpi": run}, model)
    axes = {ax.get_ylabel(): ax for ax in figure.axes if ax.axison}
    time = toss.t - toss.t[0]
    np.testing.assert_allclose(line(axes["height [m]"], "measured").get_data(), [time, toss.q[:, 2]], atol=1e-12)
    along = line(axes["distance along throw [m]"], "measured").get_ydata()
    np.testing.assert_allclose(along, toss.q[:, 1], atol=1e-9)
    np.testing.assert_allclose(line(axes["distance along throw [m]"], "cn").get_ydata() - along, 0.010, atol=1e-9)
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
    cut = Rollout(run.t[:9], run.q[:9], run.v[:9], run.lam_n[:9])
    with pytest.raises(InputError, match="swift: cn predicts"):
        toss_comparison(toss, {"cn": cut}, model)


@pytest.mark.parametrize("sustained", [30, 0])
def test_accelerations_add_up_and_sustained_contact_is_hatched(sustained: int) -> None:
    n, given, residual = 80, np.full(80, -4.0), np.full(80, -5.81)
    contact = np.where(np.arange(n) >= 50, 9.81, 0.0)
    contact[30] = 250.0
    separable = np.arange(n) < n - sustained
    parts = Accelerations(np.arange(n) / 148, given, residual, contact, given + residual + contact + 0.5, separable)
    figure = residual_over_toss(parts)
    for ax, name in zip(figure.axes, ("given", "residual", "contact", "measured"), strict=True):
        np.testing.assert_array_equal(line(ax, name).get_data(), [parts.t, getattr(parts, name)])
        hatched = [p.get_x() for p in ax.patches if p.get_hatch()]
        assert hatched == pytest.approx([49.5 / 148] if sustained else [])
        low, high = ax.get_ylim()
        drawn = np.concatenate([one.get_ydata() for one in ax.lines if len(one.get_ydata()) == n])
        assert low < drawn.min() <= drawn.max() < high
    np.testing.assert_allclose(line(figure.axes[3], "sum").get_ydata(), parts.measured - 0.5)
    assert line(figure.axes[0], "true").get_ydata()[0] == -9.81
    assert words(figure).count("not separable") == (2 if sustained else 0)
    assert "given −4.00, with the learned part −9.81, measured −9.31" in words(figure)
    assert_legible(figure)
