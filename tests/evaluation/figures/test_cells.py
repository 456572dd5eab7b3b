"""Cells of a study are pooled over seeds; what is missing takes no part."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.errors import InputError
from tossid.evaluation.figures.cells import chosen, how_pooled, models_in, pool, value_of


def cell(model: str, seed: int, x: float, mean: float | None) -> dict[str, object]:
    ends = None if mean is None else [mean - 1, mean + 2]
    return {"model": model, "seed": seed, "x": x, "error": {"mean": mean, "ci95": ends}}


def test_a_metric_is_a_mean_with_its_interval_or_a_number() -> None:
    assert value_of(cell("cn", 0, 1, 5.0), "error") == (5.0, 4.0, 7.0)
    assert value_of({"error": 3}, "error") == (3.0, 3.0, 3.0)
    assert np.isnan(value_of(cell("cn", 0, 1, None), "error")).all()
    assert np.isnan(value_of({}, "error")).all()


def test_series_are_means_over_seeds() -> None:
    cells = [cell("cn", 0, 2, 4.0), cell("cn", 1, 2, 6.0), cell("cn", 0, 1, 1.0), cell("cn", 1, 1, None)]
    series = pool([*cells, cell("e2e", 0, 2, 99.0)], model="cn", swept="x", metric="error")
    np.testing.assert_allclose(series.x, [1, 2])
    np.testing.assert_allclose(series.mean, [1, 5])
    np.testing.assert_allclose(series.low, [0, 4])
    np.testing.assert_allclose(series.high, [3, 7])
    assert len(series.points) == 3


def test_known_models_come_first() -> None:
    assert models_in([cell(name, 0, 1, 1.0) for name in ("mine", "cnrp", "cn")]) == ["cn", "cnrp", "mine"]


def test_metrics_from_flight_must_be_in_all_cells() -> None:
    flown = {**cell("cn", 0, 1, 1.0), "from_flight": {"error": 7.0}}
    assert chosen([flown], from_flight=True)[0]["error"] == 7.0
    with pytest.raises(InputError, match="1 of 2 cells"):
        chosen([flown, cell("cn", 0, 1, 1.0)], from_flight=True)
    with pytest.raises(InputError, match="no cells"):
        chosen([], from_flight=False)


def test_the_footnote_names_the_seeds() -> None:
    assert "3 seeds" in how_pooled([cell("cn", seed, 1, 1.0) for seed in range(3)])
    assert "seeds" not in how_pooled([cell("cn", 0, 1, 1.0)])
