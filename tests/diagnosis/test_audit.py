"""The audit's cases are drawn the same again, strengths reach their targets, and answers are scored as they should."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pipelines.project import load_object, object_named
from tossid.diagnosis.audit import (
    JOINT_STRENGTHS,
    KINDS,
    OUTSIDE,
    STRENGTHS,
    Case,
    draw_cases,
    draw_spoilt,
    motion,
    push_of,
    settled,
    way_between,
    world_with,
)
from tossid.diagnosis.audit_figures import audit_figures, wilson
from tossid.diagnosis.audit_scores import score, summarise
from tossid.objects import ObjectModel
from tossid.physics.effects import JOINT_EFFECTS, LIBRARY, World

DT = 1 / 148


def drawn(n: int, seed: int = 0, **options: Any) -> tuple[Case, ...]:
    return draw_cases(n, seed=seed, engines=("lcp", "mujoco"), displacement=(8.0, 300.0), **options)


def throws(n: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    q = np.zeros((n, 7))
    q[:, 2] = rng.uniform(0.15, 0.3, n)
    q[:, 3:] = rng.normal(size=(n, 4))
    q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1, keepdims=True)
    return q, np.concatenate([0.5 * rng.normal(size=(n, 3)), 3 * rng.normal(size=(n, 3))], axis=1)


def cube_world() -> World:
    return World(load_object(object_named("cube")))


# ---------------------------------------------------------------- drawing


def test_the_cases_of_a_seed_are_always_the_same_and_a_longer_audit_begins_with_them() -> None:
    assert drawn(30) == drawn(30)
    assert drawn(30)[:12] == drawn(12)
    assert drawn(30) != drawn(30, seed=1)
    assert draw_spoilt(8, seed=3)[:5] == draw_spoilt(5, seed=3)


def test_every_ten_cases_have_all_kinds_and_the_library_is_gone_through() -> None:
    cases = drawn(200)
    for first in range(0, 200, 10):
        assert sorted(case.kind for case in cases[first : first + 10]) == sorted(KINDS)
    single = [case.effects[0] for case in cases if case.kind == "effect"]
    assert set(single[: len(STRENGTHS)]) == set(STRENGTHS)
    assert {case.effects[0] for case in cases if case.kind == "outside"} == set(OUTSIDE)
    family = {effect.name: effect.family for effect in LIBRARY}
    for case in cases:
        assert all(8 <= target <= 300 for target in case.targets)
        if case.kind == "pair":
            assert family[case.effects[0]] != family[case.effects[1]]


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
    for name in ("time_base", "gravity"):
        left_out = Case(0, "without", "lcp", (name,), (20.0,), 0).without
        assert set(left_out) == {"time_base", "gravity", "uniform_force", "position_force"}
    assert Case(0, "without", "lcp", ("joint_friction",), (20.0,), 0).without == ("joint_friction",)
    assert Case(0, "effect", "lcp", ("linear_drag",), (20.0,), 0).without == ()


# ---------------------------------------------------------------- strengths


def test_all_of_the_library_has_strengths_within_its_ranges() -> None:
    assert set(STRENGTHS) == {effect.name for effect in LIBRARY}
    assert set(JOINT_STRENGTHS) == {effect.name for effect in JOINT_EFFECTS}
    rng = np.random.default_rng(0)
    for effect in (*LIBRARY, *JOINT_EFFECTS):
        known = {p.name: p for p in effect.parameters}
        strength = (STRENGTHS | JOINT_STRENGTHS)[effect.name]
        for size in (strength.low, strength.high):
            for key, value in strength.values(size, rng.uniform(-1, 1, 8)).items():
                assert known[key].low <= value <= known[key].high, (effect.name, key, value)


@pytest.mark.parametrize("name", ["gravity", "com_offset", "friction", "time_base", "cubic_drag", "telegraph_force"])
def test_strengths_move_the_object_as_far_as_asked(name: str) -> None:
    world = cube_world()
    values, reached = settled(name, 30.0, world, *throws(10), noise=1.5e-4, n_steps=100, dt=DT, seed=7)
    assert 20 < reached < 45
    again = settled(name, 30.0, world, *throws(10), noise=1.5e-4, n_steps=100, dt=DT, seed=7)
    assert again == (values, reached)


@pytest.mark.parametrize("name", sorted(JOINT_STRENGTHS))
def test_strengths_of_joints_move_the_links_as_far_as_asked(elbow: ObjectModel, name: str) -> None:
    q0, v0 = throws(10)
    q0, v0 = np.column_stack([q0, np.linspace(-2, 2, 10)]), np.column_stack([v0, np.linspace(6, -6, 10)])
    q0[:, 2] += 1.0
    _, reached = settled(name, 30.0, World(elbow), q0, v0, noise=1.5e-4, n_steps=60, dt=DT, seed=7)
    assert 20 < reached < 45


def test_the_way_is_that_of_a_known_fall() -> None:
    """Without contact, gravity less by 1 m/s² moves the object by t² / 2."""
    world = cube_world()
    q0, v0 = throws(5)
    q0[:, 2] += 50
    one, other = (
        world.recorded_poses(motion(w, q0, v0, n_steps=100, dt=DT)[0])
        for w in (world, world_with(world, {"gravity": {"g_ms2": 8.81}}))
    )
    assert way_between(one, other, DT, world.object) == pytest.approx(0.5 * (50 * DT) ** 2, rel=1e-3)


def test_forces_outside_the_library_are_what_they_say() -> None:
    q, v = throws(6)
    cubic = push_of("cubic_drag", {"c_ns3pm3": 0.2}, count=6, seconds=1, seed=0)(0.0, q, v)
    np.testing.assert_allclose(cubic, -0.2 * np.linalg.norm(v[:, :3], axis=1, keepdims=True) ** 2 * v[:, :3])
    telegraph = push_of("telegraph_force", {"x_n": 0.3, "y_n": 0.4, "switches_ps": 20}, count=400, seconds=1, seed=0)
    signs = np.array([telegraph(t, q, v)[:, 0] / 0.3 for t in np.arange(0, 1, 2e-3)])
    np.testing.assert_allclose(np.abs(signs), 1)
    assert (np.diff(signs, axis=0) != 0).sum(0).mean() == pytest.approx(20, rel=0.1)
    pulsing = push_of("pulsing_force", {"x_n": 1.0, "y_n": 0.0, "period_s": 0.1}, count=3, seconds=1, seed=0)
    np.testing.assert_allclose(pulsing(0.02, q, v), pulsing(0.12, q, v), atol=1e-12)


def test_a_push_is_a_known_motion() -> None:
    """A constant force on a flying body: the library's own and the audit's kicks agree."""
    world = cube_world()
    q0, v0 = throws(4)
    q0[:, 2] += 50
    force = np.array([0.3, -0.2, 0.0])
    pushed, _ = motion(world, q0, v0, n_steps=80, dt=DT, push=lambda t, q, v: np.tile(force, (len(q), 1)))
    there = world_with(world, {"uniform_force": {"x_n": 0.3, "y_n": -0.2}})
    np.testing.assert_allclose(pushed, motion(there, q0, v0, n_steps=80, dt=DT)[0], atol=1e-8)


# ---------------------------------------------------------------- scoring, on answers made by hand


def truth(kind: str, **effects: dict[str, float]) -> dict[str, Any]:
    return {"case": {"kind": kind}, "effects": effects}


def answer(*named: str, verdict: str = "explained", closed: float = 0.95, **found: Any) -> dict[str, Any]:
    """gap.json as far as it is scored. found: NAME={"classes": (…), "parameters": {KEY: (low, value, high)}}."""
    findings = []
    for name in dict.fromkeys([*named, *found]):
        about = found.get(name, {})
        parameters = {k: {"value": v, "ci95": [lo, hi]} for k, (lo, v, hi) in about.get("parameters", {}).items()}
        findings.append({"name": name, "confusable_with": list(about.get("classes", ())), "parameters": parameters})
    where = [{"phase": "impact", "share": 0.5}] if verdict in ("unexplained", "partly_explained") else []
    return {
        "gap": {"by_phase": [{"phase": "flight", "share": 0.2}, {"phase": "impact", "share": 0.8}]},
        "effects": findings,
        "explanation": {
            "verdict": verdict,
            "effects": list(named),
            "gap_closed": {"value": closed},
            "unexplained_where": where,
        },
    }


def test_the_right_name_first() -> None:
    friction = {"parameters": {"mu": (0.29, 0.31, 0.33)}}
    found = score(truth("effect", friction={"mu": 0.3}), answer("friction", friction=friction), closable=0.96)
    assert found["right"]
    assert found["false"] == []
    assert [p["covered"] for p in found["parameters"]] == [True]
    assert found["closed"] == pytest.approx(0.95 / 0.96)
    assert found["phase_right"]


def test_a_class_of_three_counts_and_one_of_four_does_not() -> None:
    three = answer("cohesion", cohesion={"classes": ("friction", "adhesion")})
    assert score(truth("effect", friction={"mu": 0.3}), three)["right"]
    four = answer("cohesion", cohesion={"classes": ("adhesion", "restitution", "friction")})
    found = score(truth("effect", friction={"mu": 0.3}), four)
    assert not found["right"]
    assert found["missed"] == ["friction"]


def test_the_right_name_second_is_wrong_and_the_first_is_false() -> None:
    found = score(truth("effect", friction={"mu": 0.3}), answer("magnus", "friction"))
    assert not found["right"]
    assert found["false"] == ["magnus"]


def test_a_value_outside_its_interval_is_not_covered() -> None:
    friction = {"parameters": {"mu": (0.31, 0.32, 0.33)}}
    found = score(truth("effect", friction={"mu": 0.3}), answer("friction", friction=friction))
    assert [p["covered"] for p in found["parameters"]] == [False]


def test_nulls_and_forces_outside_the_library_must_get_no_name() -> None:
    assert score(truth("null"), answer(verdict="no_gap"))["right"]
    assert score(truth("null"), answer("gravity"))["false"] == ["gravity"]
    assert score(truth("outside", cubic_drag={}), answer(verdict="unexplained"))["right"]
    hedged = score(truth("outside", cubic_drag={}), answer("linear_drag", verdict="partly_explained"))
    assert not hedged["right"]
    assert hedged["hedged"]
    assert not score(truth("outside", cubic_drag={}), answer("linear_drag"))["hedged"]


def test_both_of_a_pair_must_be_named() -> None:
    both = truth("pair", friction={"mu": 0.3}, gravity={"g_ms2": 9.0})
    assert score(both, answer("gravity", "friction"))["right"]
    assert score(both, answer("gravity", "cohesion", cohesion={"classes": ("friction",)}))["right"]
    assert score(both, answer("gravity"))["missed"] == ["friction"]


def test_without_its_effect_a_gap_must_stay_unexplained() -> None:
    found = score(truth("without", restitution={"e": 0.3}), answer(verdict="unexplained"))
    assert found["right"]
    assert found["phase_right"]
    assert not score(truth("without", restitution={"e": 0.3}), answer("compliance"))["right"]


def test_a_spoilt_parameter_must_be_restored() -> None:
    near, far = ({"parameters": {"mu": (0.1, mu, 0.3)}} for mu in (0.171, 0.16))
    for entry, restored in ((near, True), (far, False)):
        (found,) = score(truth("spoilt", friction={"mu": 0.175}), answer("friction", friction=entry))["parameters"]
        assert found["covered"]
        assert found["restored"] is restored


def test_the_summary_counts() -> None:
    scores = [
        score(truth("effect", friction={"mu": 0.3}), answer("friction", friction={"parameters": {"mu": (0, 1, 2)}})),
        score(truth("effect", friction={"mu": 0.3}), answer("magnus")),
        score(truth("null"), answer("gravity")),
        score(truth("null"), answer(verdict="no_gap")),
        score(truth("outside", cubic_drag={}), answer(verdict="unexplained")),
    ]
    found = summarise(scores)
    assert found["right_name"] == {"count": 1, "of": 2, "share": 0.5, "wanted": 0.9}
    assert found["false_names_on_nulls"] == {"count": 1, "of": 2}
    assert found["coverage"]["share"] == 1.0
    assert found["closed_median"]["value"] == pytest.approx(0.95)
    assert found["outside_not_named"]["count"] == 1
    assert found["pairs_both_named"]["share"] is None


def test_the_figures_draw_every_kind() -> None:
    rows = [
        {"kind": kind, "engine": "lcp", "effects": effects, "class": group, "first": group[0] if group else None,
         "displacement": [20.0] * len(effects), "right": right}
        for kind, effects, group, right in [
            ("effect", ["friction"], ["friction", "cohesion"], True),
            ("effect", ["magnus"], ["wind"], False),
            ("null", [], [], True),
            ("pair", ["friction", "gravity"], ["gravity"], False),
            ("outside", ["cubic_drag"], [], True),
            ("without", ["inertia"], [], True),
        ]
    ]  # fmt: skip
    figures = audit_figures(rows)
    assert set(figures) == {"confusion", "detection"}
    texts = {text.get_text() for text in figures["confusion"].axes[0].get_yticklabels()}
    assert {"nothing", "cubic_drag (no effect)", "inertia (taken out)", "friction + gravity"} <= texts


def test_wilsons_interval_is_the_published_one() -> None:
    """Newcombe 1998, table I: 81 of 263."""
    assert wilson(81, 263) == (pytest.approx(0.2553, abs=1e-4), pytest.approx(0.3662, abs=1e-4))
