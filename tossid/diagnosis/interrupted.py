"""The diagnosis that is known when one is interrupted: where the gap is, what joined so far, and what is suspected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tossid.diagnosis.findings import Finding
from tossid.diagnosis.localisation.gap import measure_gap, share_left
from tossid.diagnosis.localisation.noise import noise_floor
from tossid.diagnosis.localisation.rollouts import rollout_errors
from tossid.diagnosis.result import Diagnosis, Interruption
from tossid.diagnosis.selection.refinement import intervals
from tossid.diagnosis.under_way import SoFar
from tossid.types import Phase

MOST_SUSPECTS = 5
"""Suspects that are listed."""


def known_so_far(so_far: SoFar, stage: str) -> Diagnosis:
    """What is known at a time, as a diagnosis that says that it is not complete.

    Effects that joined are candidates. Nothing is said of the others.

    Args:
        so_far: What is known.
        stage: What was under way.
    """
    tosses, first, present = so_far.tosses, so_far.first, so_far.present
    settings = so_far.validator.settings
    short = replace(settings, localisation=replace(settings.localisation, other_lengths=()))
    validator = replace(so_far.validator, settings=short)
    floor, n = noise_floor(validator.windows), validator.n
    gap = measure_gap(tosses, first, validator, floor)
    left = gap if present is first else measure_gap(tosses, present, validator, floor)
    closed, unexplained = share_left(first, present, validator, floor)
    values, hypothesis = intervals(present.fitted, n), present.hypothesis
    findings = tuple(
        Finding(
            effect.name,
            "candidate",
            effect.says,
            tuple(Phase(phase).name.lower() for phase in effect.phases),
            values[effect.name],
            {"n_tosses": float(n)},
            closed,
        )
        for effect in hypothesis.effects
    )
    steps = tuple(
        rollout_errors(tosses, (), each, validator) for each in (first, present)[: 1 + (present is not first)]
    )
    suspects = tuple((each.effect.name, each.gain) for each in so_far.suspects[:MOST_SUSPECTS])
    return Diagnosis(
        verdict="incomplete",
        gap=gap,
        left=left,
        findings=findings,
        named=(),
        gap_closed=closed,
        unexplained=unexplained,
        steps=steps,
        hypothesis=hypothesis,
        n_tosses=n,
        seconds=so_far.seconds,
        candidates=hypothesis.names,
        noise=floor.noise,
        interruption=Interruption(stage, suspects),
        tosses=tuple(toss.name for toss in tosses),
        places=np.array([toss.q[-1, :2] for toss in tosses]),
    )
