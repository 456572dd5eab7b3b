"""Errors over tosses and along rollouts are what the metrics say; witnesses of a recording are drawn in its order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import norm

from tests.evaluation.figures.motions import toss_and_rollout
from tests.evaluation.figures.reading import assert_legible, bars, line, lines, titled, words
from tossid.errors import InputError
from tossid.evaluation.figures import (
    ErrorsAlong,
    errors_along,
    errors_along_rollout,
    errors_over_tosses,
    recording_over_order,
)
from tossid.evaluation.figures.tosses import mean_band
from tossid.evaluation.metrics import summarize
from tossid.motion import frames_in_flight
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp
from tossid.types import RecordingOrder, Rollout, Session, Toss


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
    (one,) = titled(errors_over_tosses({"cn": scores(1, seed=0)}, ["a"]), "Position").get_xticklabels()
    assert "[" not in one.get_text(), "one toss has no interval"
    same = Errors(np.full(9, 5.0), np.full(9, 5.0))
    dots = line(titled(errors_over_tosses({"cn": same}, list("abcdefghi")), "Position"), "cn")
    assert len(np.unique(dots.get_xdata())) == 9, "dots of equal errors lie side by side"


def test_what_is_not_finite_is_counted_and_what_explodes_does_not_squash_the_rest() -> None:
    given = {"cn": scores(30, seed=0), "e2e": scores(30, seed=1)}
    given["e2e"].position_error_pct[[3, 4]] = np.inf, 1e5
    names = [str(i) for i in range(30)]
    figure = errors_over_tosses(given, names)
    position = titled(figure, "Position")
    assert len(line(position, "e2e").get_ydata()) == 29
    assert "left out: 1 values" in words(figure)
    assert (position.get_yscale(), titled(figure, "Rotation").get_yscale()) == ("log", "linear")
    assert_legible(figure)
    with pytest.raises(InputError, match="cn has scores of 30 tosses, there are 29 names"):
        errors_over_tosses(given, names[1:])


def test_errors_are_lined_up_at_first_contact(cube: ObjectModel) -> None:
    toss, run = toss_and_rollout(cube)
    later = Toss("later", toss.t[9:], toss.q[9:], toss.v[9:], toss.q_cov[9:], toss.v_cov[9:], toss.phase[9:])
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


def test_few_tosses_are_drawn_one_by_one_and_one_has_no_mean_error(cube: ObjectModel) -> None:
    toss, run = toss_and_rollout(cube)
    position = errors_along_rollout({"cn": errors_along([toss, toss], [run, run], cube)}).axes[0]
    assert len(lines(position, "_toss")) == 2
    assert not position.collections, "two tosses have no band worth drawing"
    np.testing.assert_allclose(line(position, "cn").get_ydata(), 100 * 0.010 / 0.1048)
    assert "fewer than two tosses" in words(errors_along_rollout({"cn": errors_along([toss], [run], cube)}))


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
