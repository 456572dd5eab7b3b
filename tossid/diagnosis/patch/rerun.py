"""Whole tosses in MuJoCo: a hypothesis is the MJCF file that its patch makes, and is run as a person would run it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.findings import mean_over_tosses
from tossid.diagnosis.inference.brings import Runs
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.likelihood.engine_discrepancy import MujocoWorld
from tossid.diagnosis.localisation.rollouts import at_frames, distances, first_states
from tossid.diagnosis.patch.make import make_patch, patched_model
from tossid.types import Toss

Array = NDArray[np.float64]

MOST_SECONDS = 60.0
"""Of tosses that are run in one call, evenly spread over those given. Rigid contact takes 10,000 steps for each."""


def runs_in_mujoco(mjcf: Path | None = None) -> Runs:
    """Motions of whole tosses in plain MuJoCo.

    A toss begins at what its first flight determines in the hypothesis's world. Effects that MJCF cannot express take
    no part. Where the recording is wrong, motions are recorded so.

    Args:
        mjcf: The user's own model, which runs as it is under its own law without effects; a scene of the hypothesis's
            base world with nearly rigid contact if None.

    Returns:
        `Runs`; NaN also where tosses last longer than `MOST_SECONDS` together.
    """
    return partial(_runs, mjcf)


def _runs(mjcf: Path | None, hypothesis: Hypothesis, tosses: Sequence[Toss], sample: Sample) -> list[Array]:
    model, world = patched_model(hypothesis, mjcf=mjcf)
    most = max(1, int(MOST_SECONDS / np.mean([toss.t[-1] - toss.t[0] for toss in tosses])))
    some = np.unique(np.linspace(0, len(tosses) - 1, min(most, len(tosses))).astype(int))
    run_of = [tosses[i] for i in some.tolist()]
    first = first_states(run_of, world, sample.of_tosses(some).windows, n_threads=sample.n_threads)
    # the model has its own ground
    simulated = MujocoWorld(model, replace(world, ground_height=0.0, ground_tilt=(0.0, 0.0)))
    roll_out = partial(simulated.roll_out, n_threads=sample.n_threads)
    out = [np.full_like(toss.q, np.nan) for toss in tosses]
    for i, poses in zip(some.tolist(), at_frames(run_of, first, sample.windows.dt, roll_out), strict=True):
        out[i] = poses
    return out


def rerun(
    hypothesis: Hypothesis, stated: Hypothesis, tosses: Sequence[Toss], sample: Sample, *, mjcf: Path | None = None
) -> dict[str, Any]:
    """Errors in MuJoCo of whole tosses that took part, before and after the patch: gap.json's `patch.rerun`.

    Args:
        hypothesis: What was found.
        stated: The simulator as it is stated.
        tosses: That the hypothesis was fitted to.
        sample: Their windows.
        mjcf: The user's own model, if the simulator is one.
    """
    runs, width, recorded = runs_in_mujoco(mjcf), stated.base.object.width, [toss.q for toss in tosses]
    worlds = {"before": stated, "after": hypothesis}
    both = {name: distances(runs(h, tosses, sample), recorded, width) for name, h in worlds.items()}
    out: dict[str, Any] = {
        "engine": f"MuJoCo {mujoco.__version__}",
        "on": "tosses that took part in the fit",
        "not_in_it": sorted(make_patch(hypothesis, mjcf=mjcf).not_expressed),
    }
    good = np.isfinite([*both.values()]).all((0, 2))
    out["n_tosses"] = int(good.sum())
    for k, key in enumerate(("position_error_pct", "rotation_error_deg")):
        means = {name: mean_over_tosses(each[good, k]) for name, each in both.items()}
        out[key] = {name: mean.as_json() for name, mean in means.items()}
    return out
