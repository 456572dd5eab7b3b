"""Studies and training curves: lines are means over seeds, bars the given intervals, and every epoch is there."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from tests.evaluation.figures.reading import assert_legible, bars, line, lines, titled, words
from tossid.errors import InputError
from tossid.evaluation.figures import data_efficiency, gravity_sweep, inertia_study, training_curves
from tossid.evaluation.figures.studies import models_in, pool, value_of

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
    values = np.array([recovered, 1 + 0.5 * off, 10 + 3 * off, 20 + 7 * off]) + 0.1 * seed
    return {key: {"mean": v, "ci95": [v - half, v + 2 * half]} for key, v in zip(KEYS.values(), values, strict=True)}


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
    for title, key in KEYS.items():
        ax = titled(figure, title)
        for model in REPAIR:
            own = [c for c in cells if c["model"] == model]
            at = [[c[key] for c in own if c["gravity"] == 9.81 * f] for f in FRACTIONS]
            drawn = line(ax, model)
            np.testing.assert_allclose(drawn.get_xdata(), FRACTIONS, atol=0.05)
            np.testing.assert_allclose(drawn.get_ydata(), [np.mean([m["mean"] for m in ms]) for ms in at])
            for end, found in enumerate(bars(ax, model)):
                np.testing.assert_allclose(found, [np.mean([m["ci95"][end] for m in ms]) for ms in at])
            dots = lines(ax, f"{model} seeds")
            assert len(dots) == (seeds > 1)
            for one in dots:
                np.testing.assert_allclose(np.sort(one.get_ydata()), np.sort([c[key]["mean"] for c in own]))
    gravity = titled(figure, "Gravity")
    assert line(gravity, "true 9.81").get_ydata()[0] == 9.81
    np.testing.assert_allclose(line(gravity, "no repair").get_data(), [[0, 2], [0, 2 * 9.81]])
    assert line(titled(figure, "Penetration"), "measured").get_ydata()[0] == 0.7
    assert "CN 1.00,  CNRP 0.05,  CNRPI 0.00" in words(figure)
    assert (f"{seeds} seeds" in words(figure)) == (seeds > 1)
    assert_legible(figure)


def test_the_inertia_study_counts_who_reached_the_truth() -> None:
    starts = [(s, o) for s in (0.25, 0.5, 1.0, 2.0, 4.0) for o in (0.0, 0.002, 0.005, 0.01)]
    cells = [
        {
            "parameterisation": kind,
            "seed": 0,
            "inertia_scale": s,
            "com_offset_m": o,
            "inertia_error_rel": {"mean": error, "ci95": [0.9 * error, 1.2 * error]},
            "com_error_m": 0.5e-3 if o < 0.01 else 2e-3,
        }
        for kind, error in (("log-Cholesky", 0.01), ("principal moments", 0.3))
        for s, o in starts
    ]
    cells[0]["inertia_error_rel"] = float("nan")
    figure = inertia_study(cells)
    for text in ("log-Cholesky\n14 of 20 reached", "principal moments\n0 of 20 reached", "no result: 1"):
        assert text in words(figure)
    upper, _, lower, _ = figure.axes
    np.testing.assert_allclose(line(upper, "learned").get_ydata()[1:], 1.0)
    np.testing.assert_allclose(line(upper, "start").get_ydata(), [100 * abs(s - 1) for s, _ in starts])
    np.testing.assert_allclose(np.log2(line(upper, "start").get_xdata()), [np.log2(s) for s, _ in starts], atol=0.31)
    np.testing.assert_allclose(line(lower, "start").get_ydata(), [1e3 * o for _, o in starts])
    (band,) = [p for p in upper.patches if p.get_label() == "reached"]
    assert (band.get_y(), band.get_height()) == (0, 5)
    np.testing.assert_allclose([one.get_ydata() for one in lines(upper, "_interval")], np.tile([0.9, 1.2], (19, 1)))
    assert_legible(figure)


def test_a_metric_is_a_mean_with_its_interval_or_a_number_and_is_pooled_over_seeds() -> None:
    def cell(model: str, seed: int, x: float, mean: float | None) -> dict[str, object]:
        ends = None if mean is None else [mean - 1, mean + 2]
        return {"model": model, "seed": seed, "x": x, "error": {"mean": mean, "ci95": ends}}

    assert value_of(cell("cn", 0, 1, 5.0), "error") == (5.0, 4.0, 7.0)
    assert value_of({"error": 3}, "error") == (3.0, 3.0, 3.0)
    cells = [cell("cn", 0, 2, 4.0), cell("cn", 1, 2, 6.0), cell("cn", 0, 1, 1.0), cell("cn", 1, 1, None)]
    series = pool([*cells, cell("e2e", 0, 2, 99.0)], model="cn", swept="x", metric="error")
    for found, wanted in ((series.x, [1, 2]), (series.mean, [1, 5]), (series.low, [0, 4]), (series.high, [3, 7])):
        np.testing.assert_allclose(found, wanted)
    assert models_in([cell(name, 0, 1, 1.0) for name in ("mine", "cnrp", "cn")]) == ["cn", "cnrp", "mine"]


def test_a_metric_that_failed_leaves_a_gap_and_one_that_cells_lack_is_refused() -> None:
    cells = sweep(1)
    cells[2]["penetration_mm"] = {"mean": float("nan"), "ci95": [float("nan")] * 2, "n": 0}
    del cells[3]["rotation_error_deg"]
    for cell in cells:
        del cell["position_error_pct"]
    figure = gravity_sweep(cells)
    for title in ("Penetration", "Rotation"):
        assert len(line(titled(figure, title), "cn").get_ydata()) == len(FRACTIONS) - 1
    assert "not recorded" in [text.get_text() for text in titled(figure, "Position").texts]
    flight = gravity_sweep(sweep(1), from_flight=True)
    np.testing.assert_allclose(line(titled(flight, "Gravity"), "cn").get_ydata(), 5.0)
    del cells[0]["from_flight"]
    with pytest.raises(InputError, match="1 of 15 cells"):
        gravity_sweep(cells, from_flight=True)
    for draw in (gravity_sweep, training_curves):
        with pytest.raises(InputError, match=r"no cells|no epochs"):
            draw([])


def test_data_efficiency_is_over_a_base_2_axis() -> None:
    counts = [4, 8, 16, 32, 64, 128, 256]
    cells = [
        {"model": model, "seed": 0, "n_tosses": n, **metrics(9.81 + (1 + share) * 8 / n, seed=0)}
        for model, share in REPAIR.items()
        for n in counts
    ]
    figure = data_efficiency(cells)
    for title, key in KEYS.items():
        ax = titled(figure, title)
        assert ax.get_xscale() == "log"
        assert [tick.get_text() for tick in ax.get_xticklabels()] == [str(n) for n in counts]
        wanted = [c[key]["mean"] for c in cells if c["model"] == "cnrp"]
        np.testing.assert_allclose(line(ax, "cnrp").get_ydata(), wanted)
        low, high = ax.get_ylim()
        assert low <= min(bars(ax, "cnrp")[0]) < max(bars(ax, "cn")[1]) <= high
    assert_legible(figure)


def test_one_offset_is_drawn_over_the_scales() -> None:
    common = {"parameterisation": "direct", "com_offset_m": 0.01, "inertia_error_rel": 0.02}
    found = ((0.25, 1e-4), (1.0, 2e-4), (4.0, 3e-4))
    _, lower = inertia_study([{**common, "inertia_scale": scale, "com_error_m": error} for scale, error in found]).axes
    assert lower.get_xlabel() == "start: inertia / true inertia [1]"
    np.testing.assert_allclose(line(lower, "learned").get_data(), [[0.25, 1, 4], [0.1, 0.2, 0.3]])


# ---------------------------------------------------------------- training curves


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


def test_many_and_short_stages_are_legible() -> None:
    records = [replace(record, stage=f"stage {k} of the fit") for k in range(6) for record in history()[:3]]
    figure = training_curves(records)
    said = words(figure).replace("\n", " ")
    assert all(f"stage {k} of the fit 0.00375 at epoch {3 * k + 3}" in said for k in range(6))
    one = history()[0]
    short = [replace(one, stage=name) for name in (*["contact"] * 20, "rollout-20", "rollout-90")]
    for each in (figure, training_curves(short), training_curves(history()[:1])):
        assert_legible(each)
