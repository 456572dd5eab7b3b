"""The common look: labels keep apart, colours can be distinguished, nothing global changes."""

from __future__ import annotations

from itertools import combinations

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.colors import to_rgb

from tests.evaluation.figures.reading import boxes
from tossid.evaluation.figures.style import DPI, LOOKS, label_ends, look, new_figure, number, panel_grid, spread, styled

MODELS = ("cn", "cnrp", "cnrpi", "e2e", "diffsim")


# Linear RGB to what a person without the long-wave or the medium-wave cones sees (Viénot, Brettel and Mollon 1999).
PROTAN = np.array([[0.11238, 0.88762, 0], [0.11238, 0.88762, 0], [0.00401, -0.00401, 1]])

DEUTAN = np.array([[0.29275, 0.70725, 0], [0.29275, 0.70725, 0], [-0.02234, 0.02234, 1]])


@pytest.mark.parametrize("sees", [np.eye(3), PROTAN, DEUTAN], ids=["all", "protanopia", "deuteranopia"])
def test_models_can_be_distinguished(sees: np.ndarray) -> None:
    seen = {name: np.clip(sees @ np.array(to_rgb(LOOKS[name].color)) ** 2.2, 0, 1) ** (1 / 2.2) for name in MODELS}
    apart = {pair: float(np.linalg.norm(seen[pair[0]] - seen[pair[1]])) for pair in combinations(MODELS, 2)}
    by_color_alone = {pair for pair, distance in apart.items() if distance > 0.12}
    assert {("cn", "cnrp"), ("cn", "cnrpi"), ("cnrp", "cnrpi")} <= by_color_alone
    assert len({LOOKS[name].marker for name in MODELS}) == len(MODELS)
    others = ["cn", "mine", "yours"]
    assert len({look(name, others=others).color for name in others}) == 3


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (13.234, "13.2"), (-9.81, "−9.81"), (1234.0, "1234"), (3.76e-4, "3.76e−04"), (np.nan, "none")],
)
def test_numbers_are_short(value: float, text: str) -> None:
    assert number(value) == text


@given(st.lists(st.floats(0, 1), min_size=1, max_size=12))
def test_labels_are_spread_in_order_and_no_farther_than_needed(wanted: list[float]) -> None:
    gap = 0.05
    place = spread(wanted, gap)
    assert (np.diff(place[np.argsort(wanted, kind="stable")]) >= gap - 1e-9).all()
    # least squares: no shift of all labels would help
    assert np.mean(place - np.array(wanted)) == pytest.approx(0, abs=1e-9)
    if len(wanted) < 2 or np.diff(np.sort(wanted)).min() >= gap:
        np.testing.assert_allclose(place, wanted, atol=1e-12)
    np.testing.assert_allclose(spread([0.99, 0.995, 1.0], 0.1, 0.0, 1.0), [0.8, 0.9, 1.0])


def test_names_do_not_touch_and_the_users_matplotlib_is_ignored_and_left_as_it_was() -> None:
    @styled
    def draw() -> mpl.figure.Figure:
        figure = new_figure("Title", height=3)
        ax = panel_grid(figure, 1, 1, right=1)[0, 0]
        ax.set_xlabel("x [m]")
        label_ends(ax, [(1.0, 0.5, name, "k") for name in MODELS])
        return figure

    with mpl.rc_context({"font.size": 31.0, "axes.labelsize": 40.0, "figure.dpi": 31.0}):
        before = dict(mpl.rcParams)
        figure = draw()
        assert dict(mpl.rcParams) == before
    assert figure.dpi == DPI
    assert figure.axes[0].xaxis.label.get_fontsize() < 12
    found = [box for text, box in boxes(figure) if text in MODELS]
    assert len(found) == len(MODELS)
    assert not any(a.overlaps(b) for a, b in combinations(found, 2))
