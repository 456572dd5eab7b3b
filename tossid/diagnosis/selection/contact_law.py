"""Which law of contact tosses follow: before effects are sought, and once more with those that were found.

The law is no effect. It is Coulomb's with friction of an impact against the slip after it, the same against the slip as
it turns in the impact (`Law.impulse_parts`), the relaxation of the first (`Law.lifting`), or, where a user's MuJoCo
model is diagnosed, that model's own.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.engine_discrepancy import Engine
from tossid.diagnosis.likelihood.evidence import Evidence, Hypothesis
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.physics.effects import World

Array = NDArray[np.float64]


def with_contact_law(validator: CrossValidator, world: World) -> tuple[CrossValidator, World]:
    """The world with the contact law that the tosses follow most, and the validator that belongs to it.

    A user's own law is taken only together with its engine. Any simulator of a user but a MuJoCo model has its own.
    Friction against the slip as it turns is taken only where it closes a share of contact's deviance: while effects are
    missing, it may make up for a little of any.

    Args:
        validator: Of all windows.
        world: The simulator.
    """
    if validator.engine.none:
        return validator, world
    engine = validator.settings.likelihood.engine
    relaxed = replace(world, law=world.law._replace(lifting=engine.lifting))
    turning = replace(world, law=world.law._replace(impulse_parts=float(engine.impulse_parts)))
    tried = [(replace(validator, engine=Engine()), each) for each in (world, relaxed, turning)]
    if validator.engine.model is not None:
        tried.append((validator, relaxed))
    judged = validator.map(_judged, tried)
    likelihoods = [likelihood for likelihood, _ in judged]
    (_, once), _, (_, turns), *_ = judged
    if turns > (1 - engine.turning_closes) * once:
        likelihoods[2] = -np.inf
    return tried[int(np.argmax(likelihoods))]


def _judged(one: tuple[CrossValidator, World]) -> tuple[float, float]:
    """The log-likelihood of a world without effects, and the deviance of windows with contact."""
    validator, world = one
    evidence = Evidence.linearised(validator.windows, world, refine=4, n_threads=validator.n_threads)
    evidence = validator.with_engine_difference(evidence, Hypothesis(world), restarts=0)
    residuals = evidence.residuals(world)
    likelihood = evidence.log_likelihood(residuals, evidence.scales(residuals)).sum()
    return float(likelihood), float(evidence.deviances(residuals)[~evidence.windows.free].sum())


def under_other_impacts(validator: CrossValidator, present: Candidate) -> Candidate | None:
    """A hypothesis under the other law of friction in impacts, if the tosses clearly follow that one.

    The law was chosen without effects, which may have hidden which one the tosses follow. Contact that yields has no
    impacts at once.

    Args:
        validator: Of all windows.
        present: The hypothesis under the law that was chosen.
    """
    base, settings = present.hypothesis.base, validator.settings
    body = present.hypothesis.world().object
    yields = body.compliance > 0 or body.relaxation > 0
    if validator.engine.of_user or base.law.lifting > 0 or yields or not present.hypothesis.effects:
        return None
    parts = settings.likelihood.engine.impulse_parts if base.law.impulse_parts == 1 else 1
    other = replace(base, law=base.law._replace(impulse_parts=float(parts)))
    asked = [present.hypothesis, replace(present.hypothesis, base=other)]
    own, theirs = validator.map(validator.evaluate, asked)
    return theirs if validator.p_value_over(theirs, own) < settings.selection.class_level else None
