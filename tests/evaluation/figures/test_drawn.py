"""Every figure, drawn from numbers that are known: what is on it is as it was read, and all of it can be read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from tests.evaluation.figures.motions import toss_and_rollout
from tests.evaluation.figures.reading import assert_legible, described, line, titled
from tests.golden import assert_as_read
from tossid.errors import InputError
from tossid.evaluation.accelerations import Accelerations
from tossid.evaluation.figures import (
    ErrorsAlong,
    data_efficiency,
    errors_along_rollout,
    errors_over_tosses,
    geometry_at_angles,
    gravity_sweep,
    inertia_study,
    learned_geometry,
    recording_over_order,
    residual_over_toss,
    toss_comparison,
    training_curves,
)
from tossid.evaluation.figures.studies import models_in, pool, value_of
from tossid.objects import ObjectModel, load_object
from tossid.rotations import quat_exp
from tossid.types import RecordingOrder, Rollout, Session

GOLDEN = Path(__file__).parent / "golden"
CUBE, ELBOW = load_object("cube"), load_object("elbow")

# ---------------------------------------------------------------- studies

REPAIR = {"cn": 1.0, "cnrp": 0.05, "cnrpi": 0.0}
FRACTIONS = (0.0, 0.5, 1.0, 1.5, 2.0)
KEYS = ("gravity_ms2", "penetration_mm", "rotation_error_deg", "position_error_pct")


def metrics(recovered: float, *, seed: int, half: float = 0.2) -> dict[str, Any]:
    off = abs(recovered - 9.81)
    values = np.array([recovered, 1 + 0.5 * off, 10 + 3 * off, 20 + 7 * off]) + 0.1 * seed
    return {key: {"mean": v, "ci95": [v - half, v + 2 * half]} for key, v in zip(KEYS, values, strict=True)}


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


def with_gaps() -> list[dict[str, Any]]:
    """A sweep in which a metric has failed, one cell lacks another, and none has the last."""
    cells = sweep(1)
    cells[2]["penetration_mm"] = {"mean": float("nan"), "ci95": [float("nan")] * 2, "n": 0}
    del cells[3]["rotation_error_deg"]
    for cell in cells:
        del cell["position_error_pct"]
    return cells


def efficiency() -> list[dict[str, Any]]:
    return [
        {"model": model, "seed": 0, "n_tosses": n, **metrics(9.81 + (1 + share) * 8 / n, seed=0)}
        for model, share in REPAIR.items()
        for n in (4, 8, 16, 32, 64, 128, 256)
    ]


def inertia_cells() -> list[dict[str, Any]]:
    """All of log-Cholesky's starts reach the truth but the farthest and one without a result, none of the others."""
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
    return cells


def one_offset() -> list[dict[str, Any]]:
    common = {"parameterisation": "direct", "com_offset_m": 0.01, "inertia_error_rel": 0.02}
    found = ((0.25, 1e-4), (1.0, 2e-4), (4.0, 3e-4))
    return [{**common, "inertia_scale": scale, "com_error_m": error} for scale, error in found]


@dataclass
class Record:
    stage: str
    train_loss: float
    validation_loss: float
    parts: dict[str, float] = field(default_factory=dict)


def history() -> list[Record]:
    """Two stages, of each of which the last epoch but one is kept."""
    out = []
    for stage, n in (("continuous", 5), ("contact", 8)):
        for e in range(n):
            loss = 0.01 * 2.0**-e
            parts = {"prediction": 0.7 * loss, "penetration": 0.3 * loss, "residual": 0.0, "unsolved": float(e == 2)}
            out.append(Record(stage, loss, loss * (3 if e == n - 1 else 1.5), parts))
    return out


MANY_STAGES = [replace(record, stage=f"stage {k} of the fit") for k in range(6) for record in history()[:3]]
SHORT_STAGES = [replace(history()[0], stage=name) for name in (*["contact"] * 20, "rollout-20", "rollout-90")]

# ---------------------------------------------------------------- tosses


@dataclass
class Errors:
    position_error_pct: np.ndarray
    rotation_error_deg: np.ndarray


NAMES = [f"demo_{i:03d}" for i in range(100)]


def scores(names: tuple[str, ...] = ("cn", "cnrp", "cnrpi", "e2e", "diffsim"), n: int = 100) -> dict[str, Errors]:
    rngs = map(np.random.default_rng, range(len(names)))
    return {name: Errors(rng.gamma(4, 4, n), rng.gamma(4, 3, n)) for name, rng in zip(names, rngs, strict=True)}


def with_outliers() -> dict[str, Errors]:
    given = scores()
    given["cn"].position_error_pct[[17, 56]] = 120.0, 90.0
    return given


def exploding() -> dict[str, Errors]:
    given = scores(("cn", "e2e"), 30)
    given["e2e"].position_error_pct[[3, 4]] = np.inf, 1e5
    return given


def along() -> dict[str, ErrorsAlong]:
    """Thirty tosses, of which five are long: too few for a mean."""
    rng, time = np.random.default_rng(0), np.arange(-20, 80) / 148
    given = {
        name: ErrorsAlong(time, rng.gamma(4, 2, (30, 100)), rng.gamma(4, 3, (30, 100))) for name in ("cn", "cnrpi")
    }
    for one in given.values():
        one.position_error_pct[:25, 70:] = one.rotation_error_deg[:25, 70:] = np.nan
    return given


def recording() -> RecordingOrder:
    rng = np.random.default_rng(0)
    values = rng.normal(size=(6, 3))
    values[2, 1] = np.nan
    sessions = (Session("a", "c", 3, (0.04, -0.02), (0.001, 0.002), levelled=True), Session("d", "f", 3))
    turn = quat_exp(0.1 * rng.normal(size=(6, 3)))
    seen = ("fall_x", "fall_y", "height"), values, rng.normal(size=(6, 2)), turn, rng.normal(size=6)
    return RecordingOrder(sessions, "times", tuple("abcdef"), *seen, np.repeat([0, 1], 3))


def comparison(model: ObjectModel) -> Figure:
    toss, run = toss_and_rollout(model)
    return toss_comparison(toss, {"cn": run, "cnrpi": run}, model)


def accelerations(sustained: int) -> Accelerations:
    n, given, residual = 80, np.full(80, -4.0), np.full(80, -5.81)
    contact = np.where(np.arange(n) >= 50, 9.81, 0.0)
    contact[30] = 250.0
    measured, separable = given + residual + contact + 0.5, np.arange(n) < n - sustained
    return Accelerations(np.arange(n) / 148, given, residual, contact, measured, separable)


# ---------------------------------------------------------------- geometry


def shifted_corner() -> Figure:
    """One corner by 1 mm and the centre of mass by half of that, with the corners' way there."""
    shift, step = np.zeros((8, 3)), np.array([1e-3, 0, 0])
    shift[0] = step
    learned = CUBE.with_changes(corner_pos=CUBE.corner_pos + shift, com=CUBE.com + np.array([0, 0, 0.5e-3]))
    return learned_geometry(
        CUBE, learned, stages=[CUBE.corner_pos + 2 * step, CUBE.corner_pos + step, learned.corner_pos]
    )


def links() -> Figure:
    off = 1e-3 * np.random.default_rng(0).normal(size=ELBOW.corner_pos.shape)
    return learned_geometry(ELBOW, ELBOW.with_changes(corner_pos=ELBOW.corner_pos + off), truth=ELBOW)


def at_angles(seen: np.ndarray = np.arange(16) != 5) -> Figure:
    return geometry_at_angles(
        ELBOW, ELBOW.with_changes(corner_pos=ELBOW.corner_pos + np.array([1e-3, 0, 0])), seen=seen
    )


FIGURES: dict[str, Callable[[], Figure]] = {
    "sweep": lambda: gravity_sweep(sweep(1)[::-1], measured_penetration_mm=0.7),
    "sweep of three seeds": lambda: gravity_sweep(sweep(3)),
    "sweep with gaps": lambda: gravity_sweep(with_gaps()),
    "sweep from flight": lambda: gravity_sweep(sweep(1), from_flight=True),
    "data efficiency": lambda: data_efficiency(efficiency()),
    "inertia": lambda: inertia_study(inertia_cells()),
    "inertia of one offset": lambda: inertia_study(one_offset()),
    "training": lambda: training_curves(history()),
    "training of many stages": lambda: training_curves(MANY_STAGES),
    "training of short stages": lambda: training_curves(SHORT_STAGES),
    "training of one epoch": lambda: training_curves(history()[:1]),
    "errors over tosses": lambda: errors_over_tosses(with_outliers(), NAMES),
    "errors that explode": lambda: errors_over_tosses(exploding(), NAMES[:30]),
    "errors along a rollout": lambda: errors_along_rollout(along()),
    "order of recording": lambda: recording_over_order(recording()),
    "comparison": lambda: comparison(CUBE),
    "comparison of links": lambda: comparison(ELBOW),
    "residual": lambda: residual_over_toss(accelerations(0)),
    "residual, sustained": lambda: residual_over_toss(accelerations(30)),
    "geometry": shifted_corner,
    "geometry of links": links,
    "geometry at angles": at_angles,
}


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_shows_what_was_read_and_can_be_read(name: str) -> None:
    figure = FIGURES[name]()
    assert_as_read(GOLDEN / f"{name.replace(',', '').replace(' ', '-')}.txt", described(figure))
    if name not in ("sweep with gaps", "errors that explode", "geometry at angles", "order of recording"):
        assert_legible(figure)


def test_dots_of_equal_errors_lie_side_by_side() -> None:
    same = {"cn": Errors(np.full(9, 5.0), np.full(9, 5.0))}
    dots = line(titled(errors_over_tosses(same, list("abcdefghi")), "Position"), "cn")
    assert len(np.unique(dots.get_xdata())) == 9


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


def cut_rollout() -> Figure:
    toss, run = toss_and_rollout(CUBE)
    return toss_comparison(toss, {"cn": Rollout(run.t[:9], run.q[:9], run.v[:9], run.lam_n[:9])}, CUBE)


@pytest.mark.parametrize(
    ("draw", "says"),
    [
        (
            lambda: gravity_sweep([{k: v for k, v in sweep(1)[0].items() if k != "from_flight"}], from_flight=True),
            "1 of 1",
        ),
        (lambda: gravity_sweep([]), "no cells"),
        (lambda: training_curves([]), "no epochs"),
        (lambda: errors_over_tosses(exploding(), NAMES[:29]), "cn has scores of 30 tosses, there are 29 names"),
        (cut_rollout, "swift: cn predicts"),
        (lambda: at_angles(np.ones(4, dtype=bool)), "corners"),
    ],
)
def test_what_does_not_fit_together_is_not_drawn(draw: Callable[[], Figure], says: str) -> None:
    with pytest.raises(InputError, match=says):
        draw()
