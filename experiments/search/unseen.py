"""How well does what a search finds in some recorded tosses predict others?

    python -m experiments.search.unseen OUT.jsonl CUBE.h5 [--skip 0 40 80] [--tosses 40] [--most 12]

Of the dataset's training tosses, the search sees some. Others, AWAY further on, are predicted by what it has found:
whole tosses from the first states that their flights determine, and the log-likelihood of their windows over that of
the stated simulator. Neither the dataset's test split nor its validation split is read. `--most` is how many effects a
hypothesis has at most. One JSON line a search.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tossid.diagnosis.diagnose import prepare
from tossid.diagnosis.inference import search
from tossid.diagnosis.inference.found import words
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.localisation.rollouts import toss_errors
from tossid.diagnosis.problem import Problem
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.store import Dataset, read_dataset
from tossid.types import Toss

AWAY = 120
"""Tosses between the first that the search sees and the first that are predicted."""


def main() -> None:
    """Search, and predict the others."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("data", type=Path)
    parser.add_argument("--skip", type=int, nargs="*", default=[0, 40, 80])
    parser.add_argument("--tosses", type=int, default=40)
    parser.add_argument("--most", type=int, default=search.MOST_EFFECTS)
    given = parser.parse_args()
    search.MOST_EFFECTS = given.most
    recorded = read_dataset(given.data)
    train = recorded.of_split("train")
    for skip in given.skip:
        seen = train[skip : skip + given.tosses]
        others = train[skip + AWAY : skip + AWAY + given.tosses]
        line = {"skip": skip, "most": given.most, **predicted(recorded, seen, others)}
        with given.out.open("a") as file:
            file.write(json.dumps(line) + "\n")
        print(line)


def predicted(recorded: Dataset, seen: tuple[Toss, ...], others: tuple[Toss, ...]) -> dict[str, Any]:
    """What a search finds, and how it predicts other tosses.

    Args:
        recorded: Their dataset.
        seen: That are searched.
        others: That are predicted.
    """
    problem, started = problem_of(recorded, seen), time.process_time()
    found = problem.search().run().hypothesis
    seconds = time.process_time() - started
    unseen = problem_of(recorded, others)
    evidence = [unseen.sample.evidence(h) for h in (found, problem.stated)]

    def errors(hypothesis: Hypothesis) -> dict[str, list[float]]:
        each = toss_errors(others, hypothesis.world(), unseen.sample.windows, n_threads=1)
        means, medians = np.nanmean(each, axis=0), np.nanmedian(each, axis=0)
        return {"mean": means.round(3).tolist(), "median": medians.round(3).tolist()}

    return {
        "found": words(found),
        "stated_pct_deg": errors(problem.stated),
        "found_pct_deg": errors(found),
        "log_likelihood_ratio": round(float(unseen.sample.ratio(*evidence).sum()), 1),
        "processor_s": round(seconds, 1),
    }


def problem_of(recorded: Dataset, tosses: tuple[Toss, ...]) -> Problem:
    """The problem of some tosses and the nominal simulator."""
    settings = DiagnoseSettings(threads=1, repeats=0, tosses=len(tosses))
    return prepare(replace(recorded, tosses=tosses), settings=settings).problem.in_order()


if __name__ == "__main__":
    main()
