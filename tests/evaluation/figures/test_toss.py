"""A toss is compared with its prediction frame by frame; accelerations add up, and what is not separable is hatched."""

from __future__ import annotations

import numpy as np
import pytest

from tests.evaluation.figures.motions import toss_and_rollout
from tests.evaluation.figures.reading import assert_legible, line, words
from tossid.errors import InputError
from tossid.evaluation.accelerations import Accelerations
from tossid.evaluation.figures import residual_over_toss, toss_comparison
from tossid.evaluation.figures.toss import pose_frames
from tossid.types import Rollout


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
