"""The verb `tossid.evaluate`: open-loop rollouts of a trained model beside measured tosses."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

from tossid.errors import InputError
from tossid.evaluation.metrics import (
    TossScores,
    joined,
    roll_out,
    score_tosses,
    score_windows,
    summarize_scores,
)
from tossid.html import html_table
from tossid.models import TrainedModel
from tossid.models.protocol import DynamicsModel
from tossid.objects import ObjectModel
from tossid.plain_json import jsonable
from tossid.settings.changed import changed
from tossid.settings.evaluation import EvaluateSettings
from tossid.store import Dataset
from tossid.types import OnDemand, Progress, Rollout, Toss, frame_time

PARTS = ("from_flight", "sixteen_steps")
"""Keys of the metrics of other starts: the first state as the flight gives it, and short rollouts."""


@dataclass(frozen=True)
class Scores:
    """What `tossid.evaluate` returns.

    Attributes:
        model: What was evaluated.
        dataset: On which tosses.
        metrics: Position, rotation, penetration and gravity, each {"mean", "ci95"} over tosses; the same under
            "from_flight" for an object without joints and under "sixteen_steps"; and the counts "unsolved" and
            "diverged".
        per_toss: The scores of each toss, from its first state.
        dt: Time between frames of the rollouts [s].
    """

    model: TrainedModel
    dataset: Dataset = field(repr=False)
    metrics: dict[str, Any]
    per_toss: TossScores = field(repr=False)
    dt: float

    @property
    def names(self) -> tuple[str, ...]:
        """The tosses' names."""
        return tuple(toss.name for toss in self.dataset.tosses)

    @property
    def stated(self) -> ObjectModel:
        """The object whose centre, width and corners are those of the metrics."""
        return stated_object(self.model, self.dataset)

    def as_json(self) -> dict[str, Any]:
        """The metrics with the model's name and what it learned, as plain values."""
        result = {"model": self.model.name, "n_tosses": len(self.dataset.tosses), **self.metrics}
        plain: dict[str, Any] = jsonable({**result, "parameters": self.model.parameters})
        return plain

    def table(self) -> tuple[list[str], list[list[str]]]:
        """Head and rows of a table: a metric with its interval from each start."""
        head = ["metric", "mean", "95 % interval", "from flight", "95 % interval", "16 steps", "95 % interval"]
        rows = []
        for name, value in self.metrics.items():
            if isinstance(value, dict) and "mean" in value:
                others = (self.metrics.get(part, {}).get(name) for part in PARTS)
                rows.append([name, *_cells(value), *(cell for other in others for cell in _cells(other))])
        return head, rows

    def rollouts(self, settings: EvaluateSettings | None = None) -> OnDemand[Rollout]:
        """The motions that were scored, rolled out again when they are asked for.

        Args:
            settings: As of `evaluate`.
        """
        return predicted_motions(self.model.model, self.stated, self.dataset.tosses, dt=self.dt, settings=settings)

    def save(self, folder: str | Path) -> list[Path]:
        """Write metrics.json and, under figures/, errors over tosses and along rollouts, and single tosses.

        Args:
            folder: Made where it is missing.

        Returns:
            The files.
        """
        from tossid.evaluation.score_figures import write_score_figures

        folder = Path(folder)
        paths = write_score_figures(self, folder / "figures")
        metrics = folder / "metrics.json"
        metrics.write_text(json.dumps(self.as_json(), indent=2) + "\n")
        return [metrics, *paths]

    def __repr__(self) -> str:
        lines = [f"Scores of {self.model.name} on {len(self.dataset.tosses)} tosses"]
        lines += [f"  {name}: {mean} ({ends})" for name, mean, ends, *_ in self.table()[1]]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        title = f"<p><b>{escape(self.model.name)}</b> on {len(self.dataset.tosses)} tosses</p>"
        return title + html_table(*self.table())


def evaluate(
    model: TrainedModel,
    dataset: Dataset,
    *,
    settings: EvaluateSettings = EvaluateSettings(),
    progress: Progress | None = None,
    **keys: Any,
) -> Scores:
    """How far a model's open-loop rollouts are from the tosses of a dataset.

    Args:
        model: A trained model.
        dataset: Tosses that it was not trained on, such as `dataset.split("test")`; all of them are compared. Its
            object's centre, width and corners are those of the metrics; of a model that learned an unknown object, the
            learned ones.
        settings: How they are compared.
        progress: Called with what is done and the share of the tosses.
        **keys: Settings by name.

    Returns:
        The metrics with intervals over tosses; they show themselves, and `save(folder)` writes them with figures.

    Raises:
        InputError: The dataset has no tosses.
        ConfigError: A key is no setting.
    """
    settings = changed(settings, keys)
    nominal, tosses = stated_object(model, dataset), dataset.tosses
    if not len(tosses):
        raise InputError("there are no tosses to evaluate on")
    predictor, measurement, dt = model.model.simulator(), model.model.measurement, frame_time(tosses)
    starts, flights, windows = [], [], []
    for first in range(0, len(tosses), settings.batch):
        batch = tosses[first : first + settings.batch]
        how: dict[str, Any] = {"measurement": measurement, "dt": dt, "n_threads": settings.threads}
        score = partial(score_tosses, predictor, nominal, batch, **how)
        starts.append(score())
        if nominal.n_joints == 0:
            flights.append(score(from_flight=True))
        windows.append(score_windows(predictor, nominal, batch, steps=settings.short_steps, **how))
        if progress is not None:
            done = min(first + settings.batch, len(tosses))
            progress(f"{done} of {len(tosses)} tosses", done / len(tosses))
    summary = partial(summarize_scores, model=nominal, draws=settings.draws, seed=settings.seed)
    scores = joined(starts)
    metrics: dict[str, Any] = summary(scores)
    if flights:
        metrics["from_flight"] = summary(joined(flights))
    metrics["sixteen_steps"] = summary(joined(windows))
    metrics |= {"unsolved": scores.unsolved, "diverged": scores.diverged}
    return Scores(model, dataset, metrics, scores, dt)


def stated_object(model: TrainedModel, dataset: Dataset) -> ObjectModel:
    """The object whose centre, width and corners are those of the metrics.

    Args:
        model: A trained model.
        dataset: What it is compared with.

    Returns:
        The dataset's, or the learned one where the model was trained from nothing or the dataset states none.
    """
    return dataset.object if model.settings.object is None and dataset.object.is_stated else model.object


def predicted_motions(
    model: DynamicsModel,
    nominal: ObjectModel,
    tosses: Sequence[Toss],
    *,
    dt: float | None = None,
    settings: EvaluateSettings | None = None,
) -> OnDemand[Rollout]:
    """The motions that `evaluate` scores; those next to the one asked for are rolled out with it, and kept.

    Args:
        model: What is rolled out.
        nominal: The object as it is stated.
        tosses: Give the first states and the numbers of frames.
        dt: Between frames [s]; None for the tosses' median.
        settings: How many are rolled out together.
    """
    size = (settings or EvaluateSettings()).batch
    predictor, measurement, dt = model.simulator(), model.measurement, dt or frame_time(tosses)

    def batch(k: int) -> tuple[Rollout, ...]:
        some = tosses[k * size : (k + 1) * size]
        return roll_out(predictor, nominal, some, measurement=measurement, dt=dt)

    batches = OnDemand(batch, -(-len(tosses) // size), kept=1)
    return OnDemand(lambda i: batches[i // size][i % size], len(tosses), kept=0)


def metric_means(metrics: dict[str, Any]) -> dict[str, float]:
    """The metrics' means and the counts, flat, as a tracker logs them; unknown ones are left out.

    Args:
        metrics: Of `Scores`.
    """
    nested = {"": metrics, **{f"{part}/": metrics.get(part, {}) for part in PARTS}}
    found = {
        f"{prefix}{name}": value["mean"] if isinstance(value, dict) and "mean" in value else value
        for prefix, part in nested.items()
        for name, value in part.items()
    }
    return {name: float(value) for name, value in found.items() if isinstance(value, (int, float))}


def _cells(value: dict[str, Any] | None) -> list[str]:
    if value is None:
        return ["-", "-"]
    low, high = value["ci95"]
    few = value.get("n", 2) < 2  # one toss has no spread
    return [f"{value['mean']:.3g}", "-" if few else f"{low:.3g} to {high:.3g}"]
