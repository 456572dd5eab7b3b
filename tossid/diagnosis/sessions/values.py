"""What each toss alone says of an effect: one step of Gauss-Newton from a hypothesis, with its information."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.derivatives import effect_derivatives
from tossid.diagnosis.likelihood.fitting import toss_sums
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.motion.sessions.change_points import Witness
from tossid.physics.effects import Effect

Array = NDArray[np.float64]
_LEAST_INFORMATION = 1e-8
"""Share of the largest information below which a toss says nothing of a direction."""


def toss_values(present: Candidate, effect: Effect, n_tosses: int) -> tuple[Array, Array]:
    """What each toss says of an effect's parameters beside a hypothesis, in steps from their values there.

    Args:
        present: The hypothesis; where it has the effect, values count from those that it has.
        effect: The effect.
        n_tosses: n, of which windows may be missing.

    Returns:
        Values (n, P) and their information (n, P, P); 0 in directions of which a toss says nothing.
    """
    residuals = present.fitted.residuals
    _, _, J = effect_derivatives(present.evidence, present.hypothesis, effect, residuals)
    H, g = toss_sums(present.evidence, residuals, J, present.fitted.scales, n_tosses)
    w, Q = np.linalg.eigh(H)
    kept = w > _LEAST_INFORMATION * max(float(w.max(initial=0.0)), 1e-300)
    inverse = np.where(kept, 1 / np.where(kept, w, 1.0), 0.0)
    values = -np.einsum("nij,nj,nkj,nk->ni", Q, inverse, Q, g)
    return values, np.einsum("nij,nj,nkj->nik", Q, np.where(kept, w, 0.0), Q)


def witnesses_of(
    present: Candidate, library: Sequence[Effect], validator: CrossValidator, places: Array, excess: Array
) -> dict[str, Witness]:
    """What the tosses say of each effect, and how large their gap is, as `find_changes` takes them.

    Args:
        present: The hypothesis.
        library: The effects.
        validator: Of all windows.
        places: Where tosses end, (n, 2) [m].
        excess: (n,) mean deviance of each toss above the noise floor.
    """

    def one(effect: Effect) -> tuple[str, Witness]:
        return effect.name, (*toss_values(present, effect, validator.n), places)

    found = dict(validator.map(one, library))
    found = {name: witness for name, witness in found.items() if witness[1].any()}
    size = np.arcsinh(excess)[:, None]
    return {**found, RESIDUAL: (size, np.ones((validator.n, 1, 1)), places)}


RESIDUAL = "residual"
"""Name of the size of a toss's gap among what is looked at over the order."""
