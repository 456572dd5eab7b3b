"""Defects of tosses: none in simulated ones, each found where it is put in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tossid.motion import find_defects
from tossid.objects import OBJECT_FILES, ObjectModel, load_object
from tossid.physics import make_system, simulate
from tossid.rotations import quat_exp, quat_mul
from tossid.types import Toss

DT = 1 / 148


@pytest.fixture(scope="module", params=["cube", "elbow"])
def model(request: pytest.FixtureRequest) -> ObjectModel:
    return load_object(OBJECT_FILES / f"{request.param}.xml")


@pytest.fixture(scope="module")
def tosses(model: ObjectModel) -> list[Toss]:
    rng = np.random.default_rng(0)
    q = np.concatenate(
        [np.tile([0, 0, 0.35], (12, 1)), rng.normal(size=(12, 4)), np.zeros((12, model.n_joints))], axis=1
    )
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    v = rng.normal(size=(12, model.nv)) * np.r_[1, 1, 0.3, np.full(model.nv - 3, 5)]
    run = simulate(make_system(model), q, v, n_steps=90, dt=DT, substeps=8)
    cov = np.tile(1e-6 * np.eye(model.nv), (91, 1, 1))
    t, phase = np.arange(91) * DT, np.zeros(91, dtype=np.int8)
    return [Toss(str(i), t, run.q[i], run.v[i], cov, cov, phase) for i in range(12)]


def rules(tosses: list[Toss], model: ObjectModel) -> set[tuple[str, str]]:
    return {(defect.toss, defect.rule) for defect in find_defects(tosses, model)}


def test_tosses_as_physics_has_them_have_none(tosses: list[Toss], model: ObjectModel) -> None:
    assert rules(tosses, model) == set()


def test_gravity_is_what_flights_are_judged_by(tosses: list[Toss], model: ObjectModel) -> None:
    found = find_defects(tosses, model, gravity=4.0)
    assert {defect.rule for defect in found} == {"flight"}
    assert len(found) > 8
    np.testing.assert_allclose([defect.value for defect in found], 5.81, atol=0.05)


def test_a_link_that_comes_out_turned_is_a_flip(tosses: list[Toss], model: ObjectModel) -> None:
    q = tosses[3].q.copy()
    q[60:, 3:7] = quat_mul(q[60:, 3:7], quat_exp(np.array([0, 0, 0.5 * np.pi])))
    assert rules([tosses[2], replace(tosses[3], q=q)], model) == {("3", "flip")}


def test_impossible_speeds_and_jumps_are_defects(tosses: list[Toss], model: ObjectModel) -> None:
    v = tosses[5].v.copy()
    v[5, -1] += 20.0  # in the air; the pose does not follow
    assert rules([replace(tosses[5], v=v)], model) == {("5", "jolt")}
    v[70, -1] = 90.0
    assert ("5", "speed") in rules([replace(tosses[5], v=v)], model)


def test_a_flight_that_no_gravity_explains(tosses: list[Toss], model: ObjectModel) -> None:
    q = tosses[7].q.copy()
    q[:, 0] += 2.5 * tosses[7].t ** 2
    assert rules([replace(tosses[7], q=q)], model) == {("7", "flight")}
