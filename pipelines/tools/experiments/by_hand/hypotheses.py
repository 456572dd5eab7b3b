r"""Stated hypotheses, fitted to the same tosses and judged by tosses that no fit has seen.

    python -m pipelines.tools.experiments.by_hand.hypotheses DATA.h5 split=train tosses=40 law=routh \
        '{"uniform_force": {"z_n": 0.075}, "restitution": {"e": 0.3}}' '{"length_scale": {"scale_rel": 0.98}}'

A search compares one effect with one other. Whether two causes that a person thinks of explain tosses better than the
two that a search has found is seen here. Each hypothesis is fitted from the values that are given. The table has its
gain of log-likelihood over the first hypothesis, at values that the other tosses determine, the p-value of signed ranks
over the tosses, the share of the gap that it closes on unseen tosses (the test split), and errors of their rollouts.
`law` is how friction acts in an impact: "coulomb" (against the slip after it) or "routh" (as it turns meanwhile).
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import yaml
from scipy.stats import wilcoxon

from tossid.diagnosis.diagnose import prepare
from tossid.diagnosis.inference.fitting import Fit
from tossid.diagnosis.inference.found import Found
from tossid.diagnosis.inference.hypothesis import COULOMB, ROUTH, Hypothesis
from tossid.diagnosis.inference.judge import closed_share, judged_by
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.localisation.noise import noise_floor
from tossid.diagnosis.localisation.rollouts import toss_errors
from tossid.diagnosis.problem import Problem
from tossid.physics.effects import effect_named
from tossid.settings.changed import changed
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.store import read_dataset

Given = Mapping[str, Mapping[str, float]]
"""Values to begin with, by effect and parameter."""
HEADS = ("found (95 %)", "gain", "p", "closed on unseen [%]", "unseen [%], [deg]")


def hypothesis_with(base: Hypothesis, given: Given) -> Hypothesis:
    """A hypothesis at given values; parameters that are not given have their nominal ones.

    Args:
        base: Without effects.
        given: By effect and parameter.
    """
    made = base
    for name, values in given.items():
        effect = effect_named(name)
        made = made.plus(effect, effect.values_with(made.world(), values))
    return made


def rows(problem: Problem, asked: Sequence[Given]) -> Iterator[str]:
    """A row of the table for each hypothesis, as soon as it is fitted.

    Args:
        problem: Its tosses are those of the fits, and its unseen ones judge.
        asked: The hypotheses.
    """
    sample, unseen, threads = problem.sample, problem.unseen, problem.n_threads
    windows, first = problem.windows_of(unseen, problem.tosses), None
    before = sample.evidence(problem.stated)
    floor = noise_floor(windows).deviance
    for given in asked:
        made = fit_of(sample, hypothesis_with(problem.stated, given))
        first = first or made
        gain, h = sample.gains(made, first), made.hypothesis
        fold = judged_by(np.arange(len(unseen)), windows, problem.search(), Found(before, made, None, ()))
        closed = closed_share([fold], floor)
        place, turn = np.nanmean(toss_errors(unseen, h.world(), windows, n_threads=threads), axis=0)
        found = (
            f"{name}: "
            + ", ".join(f"{key} {x.value:.4g} ({x.low:.4g} to {x.high:.4g})" for key, x in made.intervals(name).items())
            for name in h.names
        )
        columns = [
            "; ".join(found),
            f"{gain.sum():+.0f}",
            f"{wilcoxon(gain).pvalue if gain.any() else 1.0:.2g}",
            f"{100 * closed.value:.1f} ({100 * closed.low:.1f} to {100 * closed.high:.1f})",
            f"{place:.2f}, {turn:.2f}",
        ]
        yield f"| {' | '.join(columns)} |"


def fit_of(sample: Sample, start: Hypothesis) -> Fit:
    """A hypothesis fitted to all tosses.

    Args:
        sample: Of the tosses.
        start: At values to begin with.
    """
    near = sample.evidence(start)
    return sample.refitted(near, start, iterations=8) if start.effects else sample.fixed(near)


def main(arguments: list[str]) -> None:
    """Print the table.

    Args:
        arguments: A dataset, `key=value` of `tossid diagnose` or `law=`, and hypotheses as JSON.
    """
    path, *others = arguments
    asked = [json.loads(each) for each in others if each.startswith("{")]
    keys = dict(each.split("=", 1) for each in others if not each.startswith("{"))
    law = {"coulomb": COULOMB, "routh": ROUTH}[keys.pop("law", "coulomb")]
    settings = changed(DiagnoseSettings(), {name: yaml.safe_load(value) for name, value in keys.items()})
    task = prepare(read_dataset(Path(path)), settings=settings)
    problem = Problem(
        task.tosses,
        Hypothesis(task.simulator.world, law),
        n_threads=settings.threads or os.cpu_count() or 1,
        seed=settings.seed,
        unseen=task.unseen,
        settings=settings,
    )
    sys.stdout.write(f"| {' | '.join(HEADS)} |\n{'|---' * len(HEADS)}|\n")
    for row in rows(problem, asked):
        sys.stdout.write(row + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
