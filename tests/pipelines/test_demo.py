"""The demo seals what is wrong, and measures poses against the truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import tossid
from pipelines.demo import WORLD, stated_simulator
from pipelines.demo_page import pose_errors
from pipelines.seal import KINDS, Opened, Sealed, judgement
from tests.models.made import tosses
from tossid.diagnosis.simulators import world_of_mjcf
from tossid.objects import ObjectModel
from tossid.physics.effects import effect_named
from tossid.rotations import geodesic_angle
from tossid.settings.synthesis import MujocoEngine
from tossid.store import Dataset


def test_frames_are_compared_with_the_toss_of_the_same_time(cube: ObjectModel) -> None:
    first, second = tosses(cube, 2, seed=1, frames=20)
    second = replace(second, t=second.t + 1.0)
    part = second.frames(slice(5, 15))
    off = replace(part, q=part.q + np.array([1e-3, 0, 0, 0, 0, 0, 0]))
    distance, angle = pose_errors(*(Dataset(cube, each, 148.0, "made") for each in ((first, second), (off,))))
    assert distance == pytest.approx(np.ones(10))
    assert angle == pytest.approx(np.zeros(10), abs=1e-6)


def test_what_is_sealed_is_drawn_from_all_kinds_and_cannot_be_guessed_from_its_hash() -> None:
    drawn = [Sealed.drawn(seed) for seed in range(200)]
    assert {each.effect for each in drawn} == set(KINDS)
    for each in drawn:
        parameter, _, ranges = KINDS[each.effect]
        assert each.parameter == parameter
        assert any(low <= each.value <= high for low, high in ranges)
    assert len({each.sha256 for each in drawn}) == 200
    assert Sealed.drawn(7) == Sealed.drawn(7)
    known = replace(drawn[0], salt="another")
    assert known.sha256 != drawn[0].sha256


def gap_of(found: dict[str, dict[str, tuple[float, float, float]]]) -> dict[str, Any]:
    """The part of gap.json that is read: effects in order, each with its parameters (value, low, high)."""
    effects = [
        {"name": name, "parameters": {key: {"value": v, "ci95": [low, high]} for key, (v, low, high) in known.items()}}
        for name, known in found.items()
    ]
    return {"effects": effects, "explanation": {"effects": list(found)}}


FRICTION = Sealed("friction", "mu", 0.31, "salt")  # 0.18 in cube.xml: a change of 0.13
NEAR, FAR = (0.3, 0.298, 0.302), (0.29, 0.288, 0.292)


@pytest.mark.parametrize(
    ("found", "right", "words"),
    [
        ({"friction": {"mu": NEAR}}, True, "0.3000 (0.2980 to 0.3020)"),
        ({"friction": {"mu": FAR}}, False, "0.2900 (0.2880 to 0.2920)"),
        ({"friction": {"mu": NEAR}, "wind": {"x_ms": NEAR}}, False, "0.3000 (0.2980 to 0.3020); besides wind"),
        ({"inertia": {"scale_rel": (1.3, 1.2, 1.4)}}, False, "not named; inertia instead"),
        ({}, False, "not named; nothing instead"),
    ],
)
def test_the_seal_stands_beside_what_was_found(found: dict[str, Any], right: bool, words: str) -> None:
    seal = Opened.of(FRICTION, gap_of(found))
    assert seal.row == ["friction mu", "0.18", "0.31", words]
    assert seal.right is right
    assert judgement(seal).startswith("Named, and nothing else" if right else ("Missed", "Named, but"))


@pytest.mark.parametrize("effect", KINDS)
def test_kinds_state_what_cube_xml_has(effect: str, tmp_path: Path) -> None:
    world, _ = world_of_mjcf(stated_simulator(tmp_path / "cube.xml"), width=0.1048)
    known = effect_named(effect)
    assert known.named(known.nominal(world))[KINDS[effect].parameter] == pytest.approx(KINDS[effect].stated, abs=1e-9)


def test_cube_xml_tosses_as_the_film_does_but_for_what_is_sealed(tmp_path: Path) -> None:
    m = mujoco.MjModel.from_xml_path(str(stated_simulator(tmp_path / "cube.xml")))
    truth = tossid.synthesize("cube", settings=replace(WORLD, tosses=2)).truth
    assert truth is not None
    assert isinstance(WORLD.engine, MujocoEngine)
    for toss in truth.tosses:
        data = mujoco.MjData(m)
        data.qpos[:], data.qvel[:] = toss.q[0], toss.v[0]
        for q in toss.q[1:41]:  # over a landing; later, the file's six digits of the time step grow to millimetres
            mujoco.mj_step(m, data, nstep=WORLD.engine.substeps)
            assert np.linalg.norm(data.qpos[:3] - q[:3]) < 1e-4
            assert geodesic_angle(data.qpos[3:], q[3:]) < 2e-3
