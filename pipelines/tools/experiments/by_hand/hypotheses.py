r"""Stated hypotheses, fitted to the same tosses and judged by tosses that no fit has seen.

    python -m pipelines.tools.experiments.by_hand.hypotheses DATA.h5 split=train tosses=40 law=routh \
        '{"uniform_force": {"z_n": 0.075}, "restitution": {"e": 0.3}}' '{"length_scale": {"scale_rel": 0.98}}'

A search compares one effect with one other. Whether two causes that a person thinks of explain tosses better than the
two that a search has found is asked here. Each hypothesis is fitted from the values that are given. The table has its
log-likelihood on the tosses of the fit beyond the first hypothesis's, signed ranks over these, the share of the gap
that it closes on unseen tosses (the test split), and errors of their rollouts. `law` is how friction acts in an impact:
"coulomb" (against the slip after it) or "routh" (as it turns meanwhile).
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from tossid.diagnosis.diagnose import prepare
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.localisation.rollouts import toss_errors
from tossid.diagnosis.localisation.unseen import judge_unseen, unseen_windows
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.selection.refinement import intervals
from tossid.physics.effects import World, effect_named
from tossid.settings.changed import changed
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.store import read_dataset
from tossid.types import Toss

Given = Mapping[str, Mapping[str, float]]
"""Values to begin with, by effect and parameter."""
HEADS = (
    "found (95 %)",
    "gain in contact, in flight",
    "p of better, of worse",
    "closed on unseen [%]",
    "unseen [%], [deg]",
)


def hypothesis_with(world: World, given: Given) -> Hypothesis:
    """A hypothesis at given values; parameters that are not given have their nominal ones.

    Args:
        world: Without effects.
        given: By effect and parameter.
    """
    effects = tuple(effect_named(name) for name in given)
    return Hypothesis(world, effects, tuple(effect.values_with(world, given[effect.name]) for effect in effects))


def fitted(validator: CrossValidator, hypothesis: Hypothesis) -> Candidate:
    """A hypothesis fitted to all tosses.

    Args:
        validator: Of their windows.
        hypothesis: At values to begin with.
    """
    there = validator.evaluate(hypothesis)
    if not hypothesis.effects:
        return there
    return validator.cross_validate(there, None, validator.refit(there.evidence, hypothesis).hypothesis)


def rows(
    tosses: Sequence[Toss], unseen: Sequence[Toss], world: World, asked: Sequence[Given], settings: DiagnoseSettings
) -> Iterator[str]:
    """A row of the table for each hypothesis, as soon as it is fitted.

    Args:
        tosses: Of the fits.
        unseen: That judge.
        world: Without effects.
        asked: The hypotheses.
        settings: Of the diagnosis.
    """
    threads = settings.threads or os.cpu_count() or 1
    validator = Problem(tosses, world, n_threads=threads, seed=settings.seed, settings=settings).validator()
    others, first = unseen_windows(unseen, tosses, world.object, validator), None
    for given in asked:
        made = fitted(validator, hypothesis_with(world, given))
        first = first or made
        gain, flies = validator.gain_over(made, first), made.evidence.windows.free
        closed = judge_unseen(others, Hypothesis(world), made.hypothesis, validator).closed
        errors = toss_errors(unseen, made.hypothesis.world(), others, n_threads=threads)
        place, turn = np.nanmean(errors, axis=0)
        columns = [
            "; ".join(
                f"{name}: " + ", ".join(f"{key} {x.value:.4g} ({x.low:.4g} to {x.high:.4g})" for key, x in each.items())
                for name, each in intervals(made.fitted, validator.n).items()
            ),
            f"{gain[~flies].sum():+.0f}, {gain[flies].sum():+.0f}",
            f"{validator.p_value_over(made, first):.2g}, {validator.p_value_over(first, made):.2g}",
            f"{100 * closed.value:.1f} ({100 * closed.low:.1f} to {100 * closed.high:.1f})",
            f"{place:.2f}, {turn:.2f}",
        ]
        yield f"| {' | '.join(columns)} |"


def main(arguments: list[str]) -> None:
    """Print the table.

    Args:
        arguments: A dataset, `key=value` of `tossid diagnose` or `law=`, and hypotheses as JSON.
    """
    path, *others = arguments
    asked = [json.loads(each) for each in others if each.startswith("{")]
    keys = dict(each.split("=", 1) for each in others if not each.startswith("{"))
    law = keys.pop("law", "coulomb")
    settings = changed(DiagnoseSettings(), {name: yaml.safe_load(value) for name, value in keys.items()})
    task = prepare(read_dataset(Path(path)), settings=settings)
    parts = {"coulomb": 1, "routh": settings.likelihood.engine.impulse_parts}[law]
    world = task.simulator.world
    world = replace(world, law=world.law._replace(impulse_parts=float(parts)))
    sys.stdout.write(f"| {' | '.join(HEADS)} |\n{'|---' * len(HEADS)}|\n")
    for row in rows(task.tosses, task.unseen, world, asked, settings):
        sys.stdout.write(row + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
