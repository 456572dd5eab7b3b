"""The figure of an audit holds its cases."""

from __future__ import annotations

from tossid.audit.figures import detection


def test_each_case_stands_at_its_least_displacement() -> None:
    right = {"engine": "lcp", "displacement": [20.0], "right": True}
    wrong = {"engine": "mujoco", "displacement": [200.0, 3.0], "right": False}
    points = [line.get_xydata() for line in detection([right, wrong]).axes[0].get_lines()]
    single = [xy[0].tolist() for xy in points if len(xy) == 1]
    assert [(x, round(y)) for x, y in single] == [(20.0, 1), (3.0, 0)]
