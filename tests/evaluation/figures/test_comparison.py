"""A toss is compared with its prediction frame by frame."""

from __future__ import annotations

import numpy as np
import pytest

from tests.evaluation.figures.motions import toss_and_rollout
from tests.evaluation.figures.reading import assert_legible, line
from tossid.errors import InputError
from tossid.evaluation.figures import toss_comparison
from tossid.evaluation.figures.comparison import pose_frames
from tossid.objects import ObjectModel
from tossid.types import Rollout


@pytest.mark.parametrize("name", ["cube", "elbow"])
def test_a_toss_is_compared_frame_by_frame(name: str, request: pytest.FixtureRequest) -> None:
    model = request.getfixturevalue(name)
    toss, run = toss_and_rollout(model)
    figure = toss_comparison(toss, {"cn": run, "cnrpi": run}, model)
    axes = {ax.get_ylabel(): ax for ax in figure.axes if ax.axison}
    assert set(axes) == {"height [m]", "distance along throw [m]", "position error [mm]", "rotation error [deg]"}
    time = toss.t - toss.t[0]
    np.testing.assert_allclose(line(axes["height [m]"], "measured").get_data(), [time, toss.q[:, 2]], atol=1e-12)
    way = line(axes["distance along throw [m]"], "measured").get_ydata()
    np.testing.assert_allclose(way, toss.q[:, 1], atol=1e-9)
    np.testing.assert_allclose(line(axes["distance along throw [m]"], "cn").get_ydata() - way, 0.010, atol=1e-9)
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
