"""Studies: lines are means over seeds, bars the given intervals, and whoever does not repair is seen not to."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.evaluation.figures.reading import assert_legible, bars, line, lines, panels, titled, words
from tossid.errors import InputError
from tossid.evaluation.figures import data_efficiency, gravity_sweep

REPAIR = {"cn": 1.0, "cnrp": 0.05, "cnrpi": 0.0}


FRACTIONS = (0.0, 0.5, 1.0, 1.5, 2.0)


KEYS = {
    "Gravity": "gravity_ms2",
    "Penetration": "penetration_mm",
    "Rotation": "rotation_error_deg",
    "Position": "position_error_pct",
}


def metrics(recovered: float, *, seed: int, half: float = 0.2) -> dict[str, Any]:
    off = abs(recovered - 9.81)
    values = (recovered, 1 + 0.5 * off, 10 + 3 * off, 20 + 7 * off)
    return {
        key: {"mean": v + 0.1 * seed, "ci95": [v + 0.1 * seed - half, v + 0.1 * seed + 2 * half], "n": 100}
        for key, v in zip(KEYS.values(), values, strict=True)
    }


def sweep(seeds: int) -> list[dict[str, Any]]:
    return [
        {
            "model": model,
            "seed": seed,
            "gravity": 9.81 * fraction,
            **metrics(9.81 * (1 + share * (fraction - 1)), seed=seed),
            "from_flight": metrics(5.0, seed=seed),
        }
        for model, share in REPAIR.items()
        for seed in range(seeds)
        for fraction in FRACTIONS
    ]


@pytest.mark.parametrize("seeds", [1, 3])
def test_the_sweep_draws_means_and_intervals(seeds: int) -> None:
    cells = sweep(seeds)
    figure = gravity_sweep(cells[::-1], measured_penetration_mm=0.7)
    assert len(figure.axes) == 4
    for title, key in KEYS.items():
        ax = titled(figure, title)
        for model in REPAIR:
            own = [c for c in cells if c["model"] == model]
            at = [[c[key] for c in own if c["gravity"] == 9.81 * f] for f in FRACTIONS]
            drawn = line(ax, model)
            np.testing.assert_allclose(drawn.get_xdata(), FRACTIONS, atol=0.05)
            np.testing.assert_allclose(drawn.get_ydata(), [np.mean([m["mean"] for m in ms]) for ms in at])
            low, high = bars(ax, model)
            np.testing.assert_allclose(low, [np.mean([m["ci95"][0] for m in ms]) for ms in at])
            np.testing.assert_allclose(high, [np.mean([m["ci95"][1] for m in ms]) for ms in at])
            dots = lines(ax, f"{model} seeds")
            assert len(dots) == (seeds > 1)
            if dots:
                np.testing.assert_allclose(
                    np.sort(dots[0].get_ydata()), np.sort([c[key]["mean"] for c in own]), err_msg="every seed is a dot"
                )
    gravity = titled(figure, "Gravity")
    assert line(gravity, "true 9.81").get_ydata()[0] == 9.81
    np.testing.assert_allclose(line(gravity, "no repair").get_data(), [[0, 2], [0, 2 * 9.81]])
    assert line(titled(figure, "Penetration"), "measured").get_ydata()[0] == 0.7
    assert "CN 1.00,  CNRP 0.05,  CNRPI 0.00" in words(figure)
    assert_legible(figure)


def test_the_sweep_from_flight() -> None:
    figure = gravity_sweep(sweep(1), from_flight=True)
    np.testing.assert_allclose(line(titled(figure, "Gravity"), "cn").get_ydata(), 5.0)
    with pytest.raises(InputError, match="15 of 15 cells"):
        gravity_sweep([{k: v for k, v in c.items() if k != "from_flight"} for c in sweep(1)], from_flight=True)
    with pytest.raises(InputError, match="no cells"):
        gravity_sweep([])


def test_a_metric_that_failed_leaves_a_gap_not_a_zero() -> None:
    cells = sweep(1)
    cells[2]["penetration_mm"] = {"mean": float("nan"), "ci95": [float("nan")] * 2, "n": 0}
    del cells[3]["rotation_error_deg"]
    for cell in cells:
        del cell["position_error_pct"]
    figure = gravity_sweep(cells)
    assert len(line(titled(figure, "Penetration"), "cn").get_ydata()) == len(FRACTIONS) - 1
    assert len(line(titled(figure, "Rotation"), "cn").get_ydata()) == len(FRACTIONS) - 1
    assert "not recorded" in [text.get_text() for text in titled(figure, "Position").texts]


def test_data_efficiency_is_over_a_base_2_axis() -> None:
    counts = [4, 8, 16, 32, 64, 128, 256]
    cells = [
        {"model": model, "seed": seed, "n_tosses": n, **metrics(9.81 + (1 + share) * 8 / n, seed=seed)}
        for model, share in REPAIR.items()
        for seed in range(3)
        for n in counts
    ]
    figure = data_efficiency(cells)
    assert len(panels(figure)) == 4
    for title, key in KEYS.items():
        ax = titled(figure, title)
        assert ax.get_xscale() == "log"
        assert ax.get_xlabel() == "training tosses [count]"
        assert [tick.get_text() for tick in ax.get_xticklabels()] == [str(n) for n in counts]
        wanted = [
            np.mean([c[key]["mean"] for c in cells if (c["model"], c["n_tosses"]) == ("cnrp", n)]) for n in counts
        ]
        np.testing.assert_allclose(line(ax, "cnrp").get_ydata(), wanted)
        low, high = ax.get_ylim()
        assert low <= min(bars(ax, "cnrp")[0])
        assert max(bars(ax, "cn")[1]) <= high
    assert_legible(figure)
