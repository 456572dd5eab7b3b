"""A toss and a rollout of it, for tests of figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.models.made import toss_of
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp
from tossid.types import Phase, Rollout, Toss


def toss_and_rollout(model: ObjectModel) -> tuple[Toss, Rollout]:
    """A fall, then a slide; the prediction is 10 mm ahead and turned by 20° about the vertical."""
    n = 60
    t = 0.3 + np.arange(n) / 148.0
    q = np.zeros((n, model.nq))
    q[:, 3] = 1
    q[:, 1] = np.linspace(0, 0.4, n)
    q[:, 2] = np.maximum(0.3 - 4.9 * (t - t[0]) ** 2, 0.0524)
    phase = np.where(np.arange(n) < 33, Phase.FLIGHT, Phase.SLIDE).astype(np.uint8)
    phase[33] = Phase.IMPACT
    toss = replace(toss_of("swift", q, cov=1e-6, phase=phase), t=t)
    ahead = q.copy()
    ahead[:, 1] += 0.010
    ahead[:, 3:7] = quat_exp(np.array([0, 0, np.deg2rad(20)]))
    return toss, Rollout(t, ahead, toss.v, np.zeros((n, model.n_corners)))
