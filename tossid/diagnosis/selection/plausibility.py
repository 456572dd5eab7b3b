"""Which fitted effects are no names: their interval holds "no change", or touches a bound of what is possible.

A parameter at the end of its physical range is where a fit was stopped, not what the tosses say: the effect stands in
for something else. It stays in the hypothesis, as it predicts better than nothing, and loses its name. Where more of an
effect changes nothing (`saturation`), no fit was stopped there.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.selection.refinement import intervals, stated_intervals
from tossid.diagnosis.selection.search_result import SearchResult
from tossid.physics.effects import Effect, Parameter, World

Array = NDArray[np.float64]
Implausible = Literal["no_change", "at_bound"]
_NEAR = 1e-6
"""Share of a parameter's range within which an end of an interval is at a bound."""


def implausible(effect: Effect, values: Mapping[str, Interval], world: World) -> Implausible | None:
    """Why an effect's intervals give it no name; None if they do.

    Parameters that only say of which form an effect is do not count, nor does a bound that is "no change" itself.

    Args:
        effect: The effect.
        values: Intervals of its parameters by name.
        world: Without the effect.
    """
    nominal = dict(zip((p.name for p in effect.parameters), effect.nominal(world), strict=True))
    sizes = [p for p in effect.parameters if not p.form]
    if any(_at_bound(p, x := values[p.name].value, x, nominal[p.name]) for p in sizes):
        return "at_bound"  # where a fit was stopped, its interval says little
    if all(values[p.name].low <= nominal[p.name] <= values[p.name].high for p in sizes):
        return "no_change"
    touches = any(_at_bound(p, values[p.name].low, values[p.name].high, nominal[p.name]) for p in sizes)
    return "at_bound" if touches else None


def implausible_alone(each: Candidate, n: int) -> Implausible | None:
    """Why the intervals of the effect that a hypothesis has added give it no name, by its own fit; None if they do.

    Args:
        each: The hypothesis, with the effect.
        n: How many tosses it is fitted to.
    """
    assert each.effect is not None
    return implausible(each.effect, intervals(each.fitted, n)[each.name], each.hypothesis.base)


def _at_bound(parameter: Parameter, low: float, high: float, nominal: float) -> bool:
    """Whether a range of a parameter ends at a bound that is not "no change" itself."""
    p, near = parameter, _NEAR * (parameter.high - parameter.low)
    return (low <= p.low + near and abs(nominal - p.low) > near) or (
        high >= p.high - near and abs(nominal - p.high) > near
    )


def plausible_names(
    validator: CrossValidator, found: SearchResult, spread: Array | None
) -> tuple[SearchResult, dict[str, Implausible]]:
    """The search's result with implausible effects nameless, and without implausible members of classes.

    Args:
        validator: Of all windows.
        found: What the search found.
        spread: (P,) standard deviations of parameters over shifted windows.

    Returns:
        The result, and why effects of the last hypothesis have no name.
    """
    hypothesis, out = found.present.hypothesis, {}
    known = stated_intervals(found, validator.n, spread)
    for effect in hypothesis.effects:
        settled = effect.name in found.unnamed or effect.name in found.saturated
        why = None if settled else implausible(effect, known[effect.name], hypothesis.base)
        if why is not None:
            out[effect.name] = why
    classes = {}
    for name, group in found.classes.items():
        kept = tuple(each for each in group if implausible_alone(each, validator.n) is None)
        classes[name] = () if name in out else kept
    return found.with_names(classes, tuple(out)), out
