"""The audit's cases are drawn the same again, and all kinds and effects are gone through."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.models.made import DT, thrown
from tossid.audit.cases import Case, draw_cases
from tossid.audit.unknown_forces import UNKNOWN_FORCES
from tossid.objects import ObjectModel
from tossid.physics.effects import LIBRARY, World, effect_named
from tossid.settings.audit import AuditSettings

KINDS = AuditSettings().kinds


def drawn(n: int, seed: int = 0, **options: Any) -> tuple[Case, ...]:
    only_lcp = options.pop("only_lcp", ())
    settings = AuditSettings(cases=n, seed=seed, **options)
    return draw_cases(settings, effects=[effect.name for effect in LIBRARY], only_lcp=only_lcp)


def test_the_cases_of_a_seed_are_always_the_same_and_a_longer_audit_begins_with_them() -> None:
    assert drawn(30) == drawn(30)
    assert drawn(30)[:12] == drawn(12)
    assert drawn(30) != drawn(30, seed=1)


def test_every_ten_cases_have_all_kinds_and_the_library_is_gone_through() -> None:
    cases = drawn(200)
    for first in range(0, 200, 10):
        assert sorted(case.kind for case in cases[first : first + 10]) == sorted(KINDS)
    single = [case.effects[0] for case in cases if case.kind == "effect"]
    assert set(single[: len(LIBRARY)]) == {effect.name for effect in LIBRARY}
    assert {case.effects[0] for case in cases if case.kind == "outside"} == set(UNKNOWN_FORCES)
    family = {effect.name: effect.family for effect in LIBRARY}
    for case in cases:
        assert all(8 <= target <= 300 for target in case.targets)
        if case.kind == "pair":
            assert family[case.effects[0]] != family[case.effects[1]]


def test_several_effects_at_once_are_no_two_forms_of_one() -> None:
    cases = drawn(40, kinds=("four", "eight"))
    assert {len(case.effects) for case in cases if case.kind == "eight"} == {8}
    assert {len(case.effects) for case in cases if case.kind == "four"} == {4}
    for case in cases:
        assert len(set(case.effects)) == len(case.targets) == len(case.effects)
        assert len({"restitution", "compliance"} & set(case.effects)) < 2
        for name in case.effects:
            effect = effect_named(name)
            assert not ({*effect.contains, *effect.made_of, *effect.one_of_group} - {name}) & set(case.effects)


def test_no_pair_is_one_effect(cube: ObjectModel) -> None:
    pairs = [set(case.effects) for case in drawn(2000, kinds=("pair",))]
    assert {"friction", "gravity"} in pairs
    for one in (
        {"gravity", "time_base"},
        {"uniform_force", "time_base"},
        {"position_force", "time_base"},
        {"wind", "uniform_force"},
        {"ground_tilt", "world_tilt"},
    ):
        assert one not in pairs


def test_a_clock_beside_a_constant_force_is_another_constant_force(cube: ObjectModel) -> None:
    """Recorded times are true times over a rate, so that recorded accelerations are true ones over its square."""
    force, rate, weight = np.array([-0.1, -0.05, -0.08]), 0.8, 9.81 * float(cube.mass.sum())
    both = effect_named("uniform_force").at(effect_named("time_base").at(World(cube), np.array([rate])), force)
    one = (force - np.array([0.0, 0.0, weight])) / rate**2 + np.array([0.0, 0.0, weight])
    alone = effect_named("uniform_force").at(World(cube), one)
    q, v = thrown(np.random.default_rng(1), 4)
    motions = [world.roll_out(q, v, n_steps=40, dt=DT, substeps=32) for world in (both, alone)]
    np.testing.assert_allclose(motions[0][..., :3], motions[1][..., :3], atol=3e-4)
    assert np.abs(motions[0] - World(cube).roll_out(q, v, n_steps=40, dt=DT, substeps=32)).max() > 0.01


def test_only_kinds_that_are_asked_for_are_drawn() -> None:
    assert {case.kind for case in drawn(12, kinds=("effect",))} == {"effect"}
    assert {case.effects for case in drawn(6, kinds=("recording",))} == {("length_scale", "world_tilt")}


def test_what_mujoco_cannot_express_is_simulated_by_lcp() -> None:
    for case in drawn(200, only_lcp=("adhesion", "cohesion")):
        if case.kind == "outside" or {"adhesion", "cohesion"} & set(case.effects):
            assert case.engine == "lcp"
    assert {case.engine for case in drawn(30) if case.kind == "null"} == {"lcp", "mujoco"}


def test_an_effect_is_taken_out_with_all_that_contain_it() -> None:
    assert Case(0, "without", "lcp", ("linear_drag",), (20.0,), 0).without == ("linear_drag", "wind")
    assert Case(0, "without", "lcp", ("restitution",), (20.0,), 0).without == ("restitution",)
    tilted = {"uniform_force", "world_tilt", "ground_tilt"}  # each is what the others make together
    assert set(Case(0, "without", "lcp", ("uniform_force",), (20.0,), 0).without) == tilted | {"position_force"}
    assert set(Case(0, "without", "lcp", ("ground_tilt",), (20.0,), 0).without) == tilted
    windless = tilted | {"position_force", "wind", "linear_drag"}
    assert set(Case(0, "without", "lcp", ("wind",), (20.0,), 0).without) == windless
    for name in ("time_base", "gravity", "length_scale"):
        left_out = Case(0, "without", "lcp", (name,), (20.0,), 0).without
        assert set(left_out) == {"time_base", "gravity", "length_scale", "uniform_force", "position_force"}
    assert Case(0, "without", "lcp", ("joint_friction",), (20.0,), 0).without == ("joint_friction",)
    assert Case(0, "effect", "lcp", ("linear_drag",), (20.0,), 0).without == ()
