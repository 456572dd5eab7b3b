"""The figure of the order of recording."""

from __future__ import annotations

import numpy as np

from tossid.evaluation.figures.sessions import recording_over_order
from tossid.rotations import quat_exp
from tossid.types import RecordingOrder, Session


def test_each_witness_is_drawn_over_order_and_place_with_its_sessions() -> None:
    rng = np.random.default_rng(0)
    names = ("fall_x", "fall_y", "height")
    values = rng.normal(size=(6, 3))
    values[2, 1] = np.nan
    order = RecordingOrder(
        (Session("a", "c", 3, (0.04, -0.02), (0.001, 0.002), levelled=True), Session("d", "f", 3)),
        "times",
        tuple("abcdef"),
        names,
        values,
        rng.normal(size=(6, 2)),
        quat_exp(0.1 * rng.normal(size=(6, 3))),
        rng.normal(size=6),
        np.repeat([0, 1], 3),
        (),
    )
    figure = recording_over_order(order)
    assert {"fall [°]", "resting height [mm]"} <= {axes.get_ylabel() for axes in figure.axes}
    assert "2 sessions" in " ".join(text.get_text() for text in figure.findobj(lambda item: hasattr(item, "get_text")))
