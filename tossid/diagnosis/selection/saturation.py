"""Effects of which more changes nothing, so that the tosses bound their size on one side only.

Any torsional friction beyond some radius stops all spin, and beyond some cohesion nothing slides. There the likelihood
is level up to the end of the parameter's range. Its curvature is nothing, and so an interval or a Wald test by
curvature says nothing either. What the tosses do say is which smaller sizes predict them worse.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.search_result import SearchResult
from tossid.physics.effects import Effect
from tossid.types import Phase

LEVEL = 0.025
"""One-sided level at which another size must predict the tosses worse to be excluded (signed ranks over tosses)."""
LARGEST_LOSS = 0.05
"""Share of what the effect gains that another size may lose on all tosses together, whatever the level says."""
HOPELESS = 0.5
"""Share of that gain lost at the present first states, from which the end of the range is not looked at closer."""
BISECTIONS = 7
"""Of the share of the size at which predictions become worse, which is then known to a hundredth of the size."""


def with_saturated_effects(validator: CrossValidator, found: SearchResult) -> SearchResult:
    """The search's result with the range of each size that the tosses bound on one side only.

    Only effects of contact with one size are looked at, away from where they do nothing.

    Args:
        validator: Of all windows.
        found: What the search found.
    """
    present = found.present
    asked = [effect for effect in present.hypothesis.effects[found.n_flight :] if Phase.FLIGHT not in effect.phases]
    ranges = {effect.name: _range(validator, found, effect) for effect in asked}
    return replace(found, saturated={name: each for name, each in ranges.items() if each is not None})


def _range(validator: CrossValidator, found: SearchResult, effect: Effect) -> Interval | None:
    """The range of an effect's size, from the smallest that predicts as well to its bound; None if that is worse."""
    sizes = [i for i, parameter in enumerate(effect.parameters) if not parameter.form]
    gained = found.needed[effect.name].total if effect.name in found.needed else 0.0
    if len(sizes) != 1 or gained <= 0:
        return None
    present, place = found.present, sizes[0]
    hypothesis, values = present.hypothesis, present.hypothesis.values_of(effect.name)
    value, nominal = float(values[place]), float(effect.nominal(present.hypothesis.base)[place])
    bound = effect.parameters[place].high if value > nominal else effect.parameters[place].low

    def at(size: float) -> Hypothesis:
        """The hypothesis with another size."""
        moved = values.copy()
        moved[place] = size
        return hypothesis.with_instead(effect.name, effect, moved)

    if not present.fitted.gain_of(at(bound)) >= -HOPELESS * gained:  # no number where a motion diverges
        return None
    between = nominal + np.sqrt((value - nominal) * (bound - nominal)) * np.sign(bound - nominal)
    own = validator.evaluate(hypothesis, present)

    def as_good(size: float) -> bool:
        """Whether another size predicts the tosses as well."""
        there = validator.evaluate(at(size), own)
        lost = float(validator.gain_over(own, there).sum())
        return lost < LARGEST_LOSS * gained and validator.p_value_over(own, there) > LEVEL

    if not (as_good(bound) and as_good(between)) or as_good(nominal):
        return None
    worse, good = 0.0, 1.0
    for _ in range(BISECTIONS):
        share = 0.5 * (worse + good)
        worse, good = (worse, share) if as_good(nominal + share * (value - nominal)) else (share, good)
    nearest = nominal + good * (value - nominal)
    return Interval(value, *sorted((nearest, bound)))
