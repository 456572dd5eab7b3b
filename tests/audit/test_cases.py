"""The audit's cases are drawn the same again, reach their strengths, and are made without naming the effect."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.models.made import DT, thrown
from tossid.audit.cases import Case, draw_cases
from tossid.audit.displacement import displacement_between, motion, strength_reaching
from tossid.audit.making import make_case
from tossid.audit.strengths import strengths_for, world_with
from tossid.audit.unknown_forces import UNKNOWN_FORCES, push_of
from tossid.objects import ObjectModel, load_object
from tossid.physics.effects import JOINT_EFFECTS, LIBRARY, World, effect_named
from tossid.settings.audit import AuditSettings
from tossid.store import read_dataset

KINDS = AuditSettings().kinds


def drawn(n: int, seed: int = 0, **options: Any) -> tuple[Case, ...]:
    only_lcp = options.pop("only_lcp", ())
    settings = AuditSettings(cases=n, seed=seed, **options)
    return draw_cases(settings, effects=[effect.name for effect in LIBRARY], only_lcp=only_lcp)


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


def test_no_pair_is_one_effect() -> None:
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


def test_the_cases_of_a_seed_are_always_the_same_and_of_the_kinds_that_are_asked_for() -> None:
    assert drawn(30) == drawn(30)
    assert drawn(30)[:12] == drawn(12)  # a longer audit begins with them
    assert drawn(30) != drawn(30, seed=1)
    assert {case.kind for case in drawn(12, kinds=("effect",))} == {"effect"}
    assert {case.effects for case in drawn(6, kinds=("recording",))} == {("length_scale", "world_tilt")}


# ---------------------------------------------------------------- strengths and motions


@pytest.mark.parametrize("name", sorted(effect.name for effect in JOINT_EFFECTS))
def test_strengths_of_joints_move_the_links_as_far_as_asked(elbow: ObjectModel, name: str) -> None:
    q0, v0 = thrown(np.random.default_rng(1), 10)
    q0, v0 = np.column_stack([q0, np.linspace(-2, 2, 10)]), np.column_stack([v0, np.linspace(6, -6, 10)])
    q0[:, 2] += 1.0
    _, reached = strength_reaching(name, 30.0, World(elbow), q0, v0, noise=1.5e-4, n_steps=60, dt=DT, seed=7)
    assert 20 < reached < 45


def test_the_way_is_that_of_a_known_fall() -> None:
    """Without contact, gravity less by 1 m/s² moves the object by t² / 2."""
    world = World(load_object("cube"))
    q0, v0 = thrown(np.random.default_rng(1), 5)
    q0[:, 2] += 50
    one, other = (
        world.recorded_poses(motion(w, q0, v0, n_steps=100, dt=DT)[0])
        for w in (world, world_with(world, {"gravity": {"g_ms2": 8.81}}))
    )
    assert displacement_between(one, other, DT, world.object) == pytest.approx(0.5 * (50 * DT) ** 2, rel=1e-3)


def test_a_push_is_a_known_motion() -> None:
    """A constant force on a flying body: the library's own and the audit's kicks agree."""
    world = World(load_object("cube"))
    q0, v0 = thrown(np.random.default_rng(1), 4)
    q0[:, 2] += 50
    force = np.array([0.3, -0.2, 0.0])
    pushed, _ = motion(world, q0, v0, n_steps=80, dt=DT, push=lambda t, q, v: np.tile(force, (len(q), 1)))
    there = world_with(world, {"uniform_force": {"x_n": 0.3, "y_n": -0.2}})
    np.testing.assert_allclose(pushed, motion(there, q0, v0, n_steps=80, dt=DT)[0], atol=1e-8)


@pytest.mark.parametrize("name", ["gravity", "com_offset", "friction", "cubic_drag", "telegraph_force"])
def test_strengths_move_the_object_as_far_as_asked(name: str) -> None:
    how = {"noise": 1.5e-4, "n_steps": 100, "dt": DT, "seed": 7}
    values, reached = strength_reaching(
        name, 30.0, World(load_object("cube")), *thrown(np.random.default_rng(1), 10), **how
    )
    assert 20 < reached < 45
    if name == "gravity":
        assert strength_reaching(
            name, 30.0, World(load_object("cube")), *thrown(np.random.default_rng(1), 10), **how
        ) == (values, reached)


def test_forces_outside_the_library_are_what_they_say() -> None:
    q, v = thrown(np.random.default_rng(1), 6)
    cubic = push_of("cubic_drag", {"c_ns3pm3": 0.2}, count=6, seconds=1, seed=0)(0.0, q, v)
    np.testing.assert_allclose(cubic, -0.2 * np.linalg.norm(v[:, :3], axis=1, keepdims=True) ** 2 * v[:, :3])
    telegraph = push_of("telegraph_force", {"x_n": 0.3, "y_n": 0.4, "switches_ps": 20}, count=400, seconds=1, seed=0)
    signs = np.array([telegraph(t, q, v)[:, 0] / 0.3 for t in np.arange(0, 1, 2e-3)])
    np.testing.assert_allclose(np.abs(signs), 1)
    assert (np.diff(signs, axis=0) != 0).sum(0).mean() == pytest.approx(20, rel=0.1)
    pulsing = push_of("pulsing_force", {"x_n": 1.0, "y_n": 0.0, "period_s": 0.1}, count=3, seconds=1, seed=0)
    np.testing.assert_allclose(pulsing(0.02, q, v), pulsing(0.12, q, v), atol=1e-12)


def test_joints_have_theirs_only_where_there_are_joints(cube: ObjectModel, elbow: ObjectModel) -> None:
    of_all = [effect.name for effect in LIBRARY if effect.name != "rotation_delay"]
    assert list(strengths_for(cube)) == of_all
    assert list(strengths_for(elbow)) == [*of_all, *(effect.name for effect in JOINT_EFFECTS)]


def test_a_world_gets_effects_with_their_other_parameters_nominal(cube: ObjectModel) -> None:
    world = world_with(World(cube), {"friction": {"mu": 0.4}, "com_offset": {"y_m": 0.003}})
    assert world.object.friction == 0.4
    np.testing.assert_allclose(world.object.com[0] - cube.com[0], [0, 0.003, 0])


# ---------------------------------------------------------------- making them


SETTINGS = AuditSettings(tosses=6)


def test_what_the_diagnosis_gets_came_through_tum_files_and_does_not_name_the_effect(tmp_path: Path) -> None:
    case = Case(3, "effect", "lcp", ("linear_drag",), (40.0,), 11)
    truth = make_case(case, load_object("cube"), SETTINGS, tmp_path)
    assert truth["effects"]["linear_drag"]["c_nspm"] > 0
    assert 30 < truth["displacement"]["linear_drag"] < 55
    assert len(list((tmp_path / "tum").glob("*.txt"))) == 6
    dataset = read_dataset(tmp_path / "tosses.h5")
    assert dataset.source == "tum"
    assert all(toss.q_cov[5, 0, 0] > 1e-9 for toss in dataset.tosses)  # noise as it is estimated from the poses
    everything = b"".join(path.read_bytes() for path in tmp_path.rglob("*") if path.is_file())
    assert b"linear_drag" not in everything
    assert b"c_nspm" not in everything


@pytest.mark.slow  # three cameras film six tosses, a minute
def test_filmed_tosses_are_tracked_and_the_film_does_not_stay(tmp_path: Path) -> None:
    case = Case(3, "effect", "lcp", ("linear_drag",), (40.0,), 11)
    make_case(case, load_object("cube"), replace(SETTINGS, filmed=True), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["tosses.h5"]
    dataset = read_dataset(tmp_path / "tosses.h5")
    assert dataset.source == "frames"
    assert len(dataset.tosses) == 6
    assert b"linear_drag" not in (tmp_path / "tosses.h5").read_bytes()


def test_a_force_outside_the_library_moves_the_tosses(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("with", "without")]
    for folder, case in zip(
        folders,
        (Case(0, "outside", "lcp", ("pulsing_force",), (60.0,), 5), Case(0, "null", "lcp", (), (), 5)),
        strict=True,
    ):
        folder.mkdir()
        make_case(case, load_object("cube"), SETTINGS, folder)
    pushed, free = (read_dataset(folder / "tosses.h5").tosses for folder in folders)
    n = [min(len(a), len(b)) for a, b in zip(pushed, free, strict=True)]
    apart = [np.linalg.norm(a.q[:k, :3] - b.q[:k, :3], axis=1).max() for a, b, k in zip(pushed, free, n, strict=True)]
    assert np.median(apart) > 10 * SETTINGS.position_noise
    start = [np.linalg.norm(a.q[0, :3] - b.q[0, :3]) for a, b in zip(pushed, free, strict=True)]
    assert max(start) < 10 * SETTINGS.position_noise  # the same releases
