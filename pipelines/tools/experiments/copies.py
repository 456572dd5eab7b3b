"""What copies of tosses that lie in two splits were worth to the scores of the published cube.

    python -m pipelines.tools.experiments.copies FOLDER [MODEL ...]

FOLDER holds the published `contactnets_cube`. The tosses are split as they were before a copy went to the split of its
first: drawn by name alone. Each model (cn, cnrp and cnrpi if none is named; gravity 9.81 m/s²) is trained on this split
and scored on all test tosses, on those without a copy in train or validation, and on those with one. Then it is trained
without the tosses that the last ones equal, and scored on them again. Rollouts of whole tosses from their first state,
means with 95 % intervals over tosses.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipelines.cli.console import Console
from pipelines.cli.failures import guarded
from tossid.evaluation.metrics import summarize
from tossid.models import TrainedModel
from tossid.motion.sessions.copies import find_copies, leak_words, leaking_copies
from tossid.store import Dataset, drawn_splits

MODELS = ("cn", "cnrp", "cnrpi")
HEAD = ("model", "trained on", "test tosses", "", "position [%]", "rotation [deg]")
Scores = NDArray[np.float64]


def drawn_by_name(dataset: Dataset) -> Dataset:
    """The dataset with splits that were drawn by name alone, with no regard to copies.

    Args:
        dataset: Of any splits.
    """
    split = drawn_splits(dataset.names, seed=0)
    return replace(dataset, tosses=tuple(replace(toss, split=split[toss.name]) for toss in dataset.tosses))


def without_twins(dataset: Dataset) -> Dataset:
    """The dataset without the training and validation tosses that equal a test toss.

    Args:
        dataset: With copies in several splits.
    """
    groups: dict[str, set[str]] = {}
    for copy in find_copies(dataset.tosses):
        groups.setdefault(copy.of, {copy.of}).add(copy.name)
    test = {toss.name for toss in dataset.of_split("test")}
    twins = set[str]().union(*(group for group in groups.values() if group & test)) - test
    return replace(dataset, tosses=tuple(toss for toss in dataset.tosses if toss.name not in twins))


def scores_of(model: TrainedModel, tosses: Dataset) -> Scores:
    """Errors of position [%] and rotation [deg] of each toss, (n, 2)."""
    import tossid

    found = tossid.evaluate(model, tosses).per_toss
    return np.column_stack([found.position_error_pct, found.rotation_error_deg])


def rows_of(name: str, dataset: Dataset) -> list[list[str]]:
    """Rows of a model: the scores with and without what leaks, and of what leaks with and without its copies.

    Args:
        name: Of the model.
        dataset: With splits that leak.
    """
    import tossid

    held_out = dataset.split("test")
    leaks = np.isin(held_out.names, leaking_copies(dataset.tosses)["test"])
    without = without_twins(dataset)
    fewer = len(dataset) - len(without)
    seen = scores_of(tossid.train(dataset, model=name, gravity=9.81), held_out)
    unseen = scores_of(tossid.train(without, model=name, gravity=9.81), held_out)
    rows = []
    for trained, scores, chosen, what in (
        ("all", seen, leaks | True, "all"),
        ("all", seen, ~leaks, "without a copy in train or validation"),
        ("all", seen, leaks, "with one"),
        (f"{fewer} less", unseen, leaks, "the same, their copies left out"),
        ("", unseen - seen, leaks, "difference, toss by toss"),
        (f"{fewer} less", unseen, leaks | True, "all, the copies left out"),
    ):
        cells = (summarize(column) for column in scores[chosen].T)
        texts = [f"{cell['mean']:.2f} ({cell['ci95'][0]:.2f} to {cell['ci95'][1]:.2f})" for cell in cells]
        rows.append([f"`{name}`", trained, str(int(chosen.sum())), what, *texts])
    return rows


def main(folder: Path, models: list[str]) -> None:
    """Say how far the scores of each model depend on copies."""
    import tossid

    console = Console()
    dataset = drawn_by_name(tossid.ingest(folder / "contactnets_cube", source="contactnets"))
    console.say(leak_words(dataset.tosses) or "no copy leaks")
    rows = [row for name in models or MODELS for row in rows_of(name, dataset)]
    console.table(HEAD, rows)


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(Path(sys.argv[1]), sys.argv[2:]), "copies"))
