"""The patched model run in MuJoCo on the tosses, beside the model before the patch."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.engine_discrepancy import MujocoWorld
from tossid.diagnosis.likelihood.evidence import Evidence, Hypothesis
from tossid.diagnosis.likelihood.whitening import linearise
from tossid.diagnosis.likelihood.windows import Windows, make_windows
from tossid.diagnosis.localisation.gap import bootstrap_ratio, by_toss, deviance
from tossid.diagnosis.localisation.noise import expected_deviance
from tossid.diagnosis.localisation.rollouts import first_states
from tossid.diagnosis.patch.make import Patch
from tossid.evaluation.metrics import summarize
from tossid.objects import ObjectModel, center_positions, corner_heights
from tossid.physics.effects import World
from tossid.rotations import geodesic_angle
from tossid.settings.diagnosis.patch import PatchSettings
from tossid.types import Toss, frame_time

Array = NDArray[np.float64]


def rerun(
    patch: Patch,
    hypothesis: Hypothesis,
    tosses: Sequence[Toss],
    stated: ObjectModel,
    *,
    n_threads: int = 1,
    settings: PatchSettings = PatchSettings(),
) -> dict[str, Any]:
    """The prediction errors of MuJoCo before and after the patch: gap.json's `patch.rerun`.

    The gap is that of short windows, whitened as in the diagnosis. Each window's first state is estimated from its own
    frames under tossid's simulator with the same effects, without those that MJCF cannot express. The rollouts run
    over whole tosses, from first states that are estimated from flight under the patched world. Both models start from
    the same states.

    Args:
        patch: Both models.
        hypothesis: The world that the patch was made for.
        tosses: The tosses.
        stated: The dataset's object, to whose centre and width errors refer.
        n_threads: Threads of the simulators.
        settings: How many steps are affordable.

    Returns:
        The gap and the rollout errors `before` and `after`, and the share of the gap that is closed.
    """
    for effect in hypothesis.effects:
        if effect.name in patch.not_expressed:  # first states under it would be wrong in MuJoCo
            hypothesis = hypothesis.minus(effect.name)
    worlds = {"before": hypothesis.base, "after": hypothesis.world()}
    models = {"before": patch.before, "after": patch.after}
    tosses = _affordable(tosses, min(float(model.opt.timestep) for model in models.values()), settings)
    windows = make_windows(tosses, stated, flights=False)
    n = len(tosses)
    q0, v0 = first_states(tosses, worlds["after"], n_threads=n_threads)
    out: dict[str, Any] = {
        "engine": f"MuJoCo {mujoco.__version__}",
        "n_tosses": n,
        "on": "tosses that took part in the fit",
        "not_in_it": sorted(patch.not_expressed),
        "gap": {"unit": "standard deviations of noise"},
        "position_error_pct": {},
        "rotation_error_deg": {},
        "timestep_s": {},
        "lost": {},
    }
    excess = {}
    for name, model in models.items():
        simulated = MujocoWorld(model, replace(worlds[name], ground_height=0.0, ground_tilt=(0.0, 0.0)))
        evidence, residual = _residuals(windows, worlds[name], simulated, n_threads=n_threads)
        excess[name] = by_toss(evidence, _excess(evidence, residual), n)
        inside = evidence.windows.inside[..., None] * np.ones(residual.shape[-1])
        squares = np.where(inside > 0, np.minimum(residual**2, evidence.density.largest_residual**2), 0.0)
        ratio = bootstrap_ratio(by_toss(evidence, squares, n), by_toss(evidence, inside, n))
        out["gap"][name] = {"value": math.sqrt(ratio.value), "ci95": [math.sqrt(ratio.low), math.sqrt(ratio.high)]}
        position, rotation = _rollouts(simulated, tosses, stated, q0, v0, n_threads=n_threads)
        for key, values in (("position_error_pct", position), ("rotation_error_deg", rotation)):
            mean = summarize(values)
            out[key][name] = {"value": mean["mean"], "ci95": mean["ci95"]}
        out["timestep_s"][name] = float(model.opt.timestep)
        out["lost"][name] = int((~np.isfinite(position)).sum())
    out["gap_closed"] = bootstrap_ratio(excess["before"] - excess["after"], excess["before"]).as_json()
    return out


def _excess(evidence: Evidence, residual: Array) -> Array:
    """(W, L, K) deviance above what a standard normal has on average; 0 outside the windows."""
    floor = expected_deviance(1.0, evidence.density)
    return np.where(evidence.windows.inside[..., None], deviance(evidence, residual) - floor, 0.0)


def _affordable(tosses: Sequence[Toss], timestep: float, settings: PatchSettings) -> Sequence[Toss]:
    """All tosses, or as many of them, evenly spread, as can be run four times within the steps allowed."""
    seconds = float(np.mean([toss.t[-1] - toss.t[0] for toss in tosses]))
    most = max(settings.fewest_tosses, int(settings.most_steps * timestep / (4 * seconds)))
    return [tosses[i] for i in np.unique(np.linspace(0, len(tosses) - 1, min(most, len(tosses))).astype(int))]


def _residuals(windows: Windows, world: World, simulated: MujocoWorld, *, n_threads: int) -> tuple[Evidence, Array]:
    """Whitened residuals (W, L, K) of MuJoCo in windows whose first states are refined under tossid's own simulator.

    The ground is lowered for a window that begins below rigid ground. A tracker's error has put the object there, and
    MuJoCo's stiff spring would throw it up, where tossid's contact leaves it.
    """
    kept, whitening = linearise(windows, world, refine=2, n_threads=n_threads)
    sunk = corner_heights(world.object, world.to_ground(kept.at_q, kept.at_v)[0]).min(-1)
    q, lift = kept.at_q.copy(), np.maximum(-sunk, 0.0) * (world.object.compliance == 0)
    q[:, 2] += lift
    run = simulated.roll_out(q, kept.at_v, n_steps=kept.steps, dt=kept.dt, n_threads=n_threads)
    run[..., 2] -= lift[:, None]
    return Evidence(kept, whitening, n_threads), whitening(kept.residuals(run[:, 1:]))


def _rollouts(
    simulated: MujocoWorld, tosses: Sequence[Toss], stated: ObjectModel, q0: Array, v0: Array, *, n_threads: int
) -> tuple[Array, Array]:
    """Mean position error [% of width] and rotation error [deg] of each toss (B,); NaN where MuJoCo gave up."""
    dt = frame_time(tosses)
    ticks = [toss.ticks(dt) for toss in tosses]
    steps = np.array([each[-1] for each in ticks])
    run = simulated.roll_out(q0, v0, n_steps=steps, dt=dt, n_threads=n_threads)
    position, rotation = np.empty(len(tosses)), np.empty(len(tosses))
    for i, toss in enumerate(tosses):
        q = run[i, ticks[i]]
        far = np.linalg.norm(center_positions(stated, q) - center_positions(stated, toss.q), axis=1)
        position[i] = 100 * far.mean() / stated.width
        rotation[i] = np.rad2deg(geodesic_angle(q[:, 3:7], toss.q[:, 3:7])).mean()
    return position, rotation
