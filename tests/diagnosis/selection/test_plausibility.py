"""An effect whose interval holds no change or touches a bound has no name; a form and a natural zero do not count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen
from tossid.diagnosis.findings import Interval
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.plausibility import implausible, plausible_names
from tossid.diagnosis.selection.search_result import SearchResult
from tossid.objects import ObjectModel
from tossid.physics.effects import LIBRARY, World, effects_for


@pytest.mark.parametrize(
    ("name", "values", "why"),
    [
        # as of the die: 17 kN/m, whose interval was -8.9 to 43 before it ended at physics
        ("compliance", {"stiffness_npm": (1.7e4, 50.0, 4.3e4)}, "at_bound"),
        ("compliance", {"stiffness_npm": (1.7e4, 1.2e4, 4.3e4)}, None),
        ("compliance", {"stiffness_npm": (1.9e5, 1.2e5, 2.6e5)}, "no_change"),
        ("anisotropic_friction", {"x_mu": (0.2, 0.005, 0.45), "y_mu": (0.005, 0.005, 0.1)}, "at_bound"),
        ("anisotropic_friction", {"x_mu": (0.25, 0.22, 0.28), "y_mu": (0.18, 0.17, 0.19)}, None),
        ("restitution", {"e": (0.1, 0.02, 0.18)}, None),
        ("restitution", {"e": (0.1, 0.0, 0.22)}, "no_change"),
        # one axis of a vector may well be unchanged
        ("com_offset", {"x_m": (0.006, 0.005, 0.007), "y_m": (0.0, -1e-3, 1e-3), "z_m": (0.0, -1e-3, 1e-3)}, None),
        ("wind", {"x_ms": (2.0, 1.5, 2.5), "y_ms": (0.0, -0.5, 0.5)}, None),
    ],
)
def test_intervals_that_give_no_name(
    cube: ObjectModel, name: str, values: dict[str, tuple[float, float, float]], why: str | None
) -> None:
    effect = EFFECTS[name]
    nominal = dict(zip((p.name for p in effect.parameters), effect.nominal(World(cube)), strict=True))
    # parameters that only say of which form it is are at a bound
    form = {p.name: (nominal[p.name], p.low, p.high) for p in effect.parameters}
    assert implausible(effect, {k: Interval(*v) for k, v in (form | values).items()}, World(cube)) == why


def test_no_patch_of_contact_is_wider_than_the_object(cube: ObjectModel) -> None:
    die = cube.with_changes(corner_pos=cube.corner_pos * (0.03 / 0.0524))  # 60 mm wide
    bounds = {effect.name: effect.parameters for effect in effects_for(die)}
    diagonal = 0.06 * np.sqrt(3)
    for name in ("torsional_friction", "rolling_resistance"):
        assert bounds[name][0].high == pytest.approx(diagonal / 2)
    assert bounds["com_offset"][0].high == EFFECTS["com_offset"].parameters[0].high
    marble = cube.with_changes(corner_pos=cube.corner_pos / 10)
    small = {effect.name: effect for effect in effects_for(marble)}
    assert small["rounded_corners"].parameters[0].high == pytest.approx(0.00524)
    assert max(start["radius_m"] for start in small["torsional_friction"].starts) <= 0.0091
    assert effects_for(cube)[0] is LIBRARY[0]


def test_an_effect_at_its_bound_stays_without_its_name(cube: ObjectModel) -> None:
    tosses = seen(World(cube.with_changes(friction=0.3)), cube, 6, seed=4, frames=60)
    validator = CrossValidator.of(tosses, cube, seed=0)
    first = validator.evaluate(Hypothesis(World(cube)))
    friction = EFFECTS["friction"]
    low = replace(friction, parameters=(replace(friction.parameters[0], high=0.25),))
    last = validator.cross_validate(first, low, first.hypothesis.plus(low))
    found = SearchResult(first, last, (first, last), {}, {}, {"friction": last}, {"friction": ()})
    named, why = plausible_names(validator, found, None)
    assert why == {"friction": "at_bound"}
    assert named.unnamed == {"friction"}
    assert named.present.hypothesis.names == ("friction",)
    free = validator.cross_validate(first, friction, first.hypothesis.plus(friction))
    found = SearchResult(first, free, (first, free), {}, {}, {"friction": free}, {"friction": (last,)})
    named, why = plausible_names(validator, found, None)
    assert why == {}
    assert named.classes == {"friction": ()}
