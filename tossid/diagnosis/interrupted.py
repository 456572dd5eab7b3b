"""The diagnosis that is known when one is interrupted: where the gap is, what joined so far, and what is suspected."""

from __future__ import annotations

import numpy as np

from tossid.diagnosis.effect_findings import NOTHING, changes, phases_of
from tossid.diagnosis.findings import Finding
from tossid.diagnosis.inference.brings import brings_of, felt_of_each, runs_in_tossid
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.localisation.gap import measure_gap, rows_of
from tossid.diagnosis.localisation.noise import noise_floor
from tossid.diagnosis.result import Diagnosis, Interruption
from tossid.diagnosis.under_way import SoFar

MOST_SUSPECTS = 5
"""Suspects that are listed."""


def known_so_far(so_far: SoFar, stage: str) -> Diagnosis:
    """What is known at a time, as a diagnosis that says that it is not complete.

    Effects that joined are candidates. Values were fitted to the tosses that they predict, which the report says.

    Args:
        so_far: What is known.
        stage: What was under way.
    """
    tosses, first, present = so_far.tosses, so_far.first, so_far.present
    h = first.hypothesis if present is None else present.hypothesis
    everything = present is not None and len(present.evidence.windows.toss) == len(first.windows.toss)
    last = present.evidence if present is not None and everything else first  # a round of flight has flight alone
    numbers, floor = np.arange(len(tosses)), noise_floor(first.windows)
    before, after = (rows_of([(each, numbers)], floor) for each in (first, last))
    sample = Sample(first.windows, len(tosses), first.n_threads)
    felt = felt_of_each(h, tosses, sample)
    findings = tuple(
        Finding(
            effect.name,
            "candidate",
            effect.says,
            phases_of(effect),
            {} if present is None or not present.own(effect.name) else present.intervals(effect.name),
            effect.named(effect.nominal(first.hypothesis.world())),
            {"n_tosses": float(len(tosses))},
            NOTHING,
            felt=felt[effect.name],
        )
        for effect in h.effects
    )
    stated = runs_in_tossid(first.hypothesis, tosses, sample)
    changed = runs_in_tossid(h, tosses, sample) if h.effects else stated
    return Diagnosis(
        verdict="incomplete",
        gap=measure_gap(tosses, before, floor),
        left=measure_gap(tosses, after, floor),
        findings=findings,
        change=changes(findings),
        brings=brings_of(tosses, stated, changed, width=h.base.object.width, unseen=False),
        gap_closed=NOTHING,
        unexplained=(),
        hypothesis=h,
        n_tosses=len(tosses),
        seconds=so_far.seconds,
        noise=floor.noise,
        interruption=Interruption(stage, so_far.suspects[:MOST_SUSPECTS]),
        tosses=tuple(toss.name for toss in tosses),
        places=np.array([toss.q[-1, :2] for toss in tosses]),
    )
