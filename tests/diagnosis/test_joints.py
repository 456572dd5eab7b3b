"""Diagnosis of an object with a joint: two links that are thrown, and what is the matter with the hinge."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.tossed import POSITION, ROTATION
from tests.models.made import DT, thrown
from tossid.diagnosis.attribution import diagnose
from tossid.diagnosis.evidence import Evidence
from tossid.diagnosis.gap import first_states
from tossid.diagnosis.whitening import linearise
from tossid.diagnosis.windows import difference, make_windows, moved_pose
from tossid.diagnosis.wrench import with_wrench
from tossid.motion import label_phases
from tossid.objects import ObjectModel
from tossid.physics.effects import World, library_for
from tossid.types import Toss

K = 7


def seen(world: World, nominal: ObjectModel, count: int, *, seed: int, frames: int, height: float) -> list[Toss]:
    """Tosses of a world from so much higher than where a cube is thrown, recorded with noise."""
    rng = np.random.default_rng(seed)
    q, v = thrown(rng, count)
    q = np.concatenate([q, rng.uniform(-3, 3, (count, 1))], axis=1)
    v = np.concatenate([v, 5 * rng.normal(size=(count, 1))], axis=1)
    q[:, 2] += height
    run = world.roll_out(q, v, n_steps=frames, dt=DT, substeps=16, impact_parts=8)
    t = np.arange(frames + 1) * DT
    std = np.array([POSITION] * 3 + [ROTATION] * 4)
    cov = np.broadcast_to(np.diag(std**2), (frames + 1, K, K)).copy()
    v_cov = np.broadcast_to(np.diag([0.03**2] * 3 + [0.3**2] * 4), (frames + 1, K, K)).copy()
    out = []
    for i in range(count):
        poses = moved_pose(run[i], std * rng.normal(size=(frames + 1, K)))
        speed = difference(poses[1:], poses[:-1]) / DT
        velocity = np.concatenate([speed, speed[-1:]])
        phase = label_phases(nominal, t, poses, velocity, gravity=9.81)
        out.append(Toss(str(i), t, poses, velocity, cov, v_cov, phase))
    return out


def with_effect(model: ObjectModel, name: str, values: list[float]) -> World:
    effect = next(effect for effect in library_for(model) if effect.name == name)
    return effect.at(World(model), np.array(values))


def test_whitened_misses_are_noise_at_the_truth(elbow: ObjectModel) -> None:
    world = with_effect(elbow, "joint_damping", [2e-3])
    tosses = seen(world, elbow, 10, seed=1, frames=24, height=0.1)
    windows, whitening = linearise(make_windows(tosses, elbow), world, refine=6)
    assert windows.channels == K
    r = Evidence(windows, whitening).residual(world)[windows.inside]
    assert r.shape[1] == K
    np.testing.assert_allclose(r.std(axis=0), 1.0, atol=0.15)


def test_a_moved_pose_differs_by_what_it_was_moved_by() -> None:
    rng = np.random.default_rng(0)
    q, by = rng.normal(size=(50, K + 1)), 0.5 * rng.normal(size=(50, K))
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    np.testing.assert_allclose(difference(moved_pose(q, by), q), by, atol=1e-12)


def test_a_joint_s_torque_is_constant_whatever_its_spring(elbow: ObjectModel) -> None:
    tosses = seen(World(elbow), elbow, 2, seed=2, frames=20, height=2.0)
    q, v = (np.stack([getattr(toss, name)[0] for toss in tosses]) for name in ("q", "v"))
    torque, inertia = 0.02, 1e-3
    for stiffness in (0.0, 0.05):
        law = elbow.joints._replace(stiffness=np.array([0.0, stiffness]), rest=np.array([0.0, 0.4]))
        world = World(elbow.with_changes(joint_law=law))
        pushed = with_wrench(world, np.array([0.0] * 6 + [torque]))
        ways = [each.roll_out(q, v, n_steps=4, dt=DT, substeps=8)[:, -1, 7] for each in (world, pushed)]
        assert (ways[1] - ways[0] > 0.5 * torque / inertia * (4 * DT) ** 2 / 20).all()


def test_first_states_are_those_of_the_flight(elbow: ObjectModel) -> None:
    world = World(elbow)
    tosses = seen(world, elbow, 6, seed=3, frames=30, height=1.0)
    q, v = first_states(tosses, world)
    run = world.roll_out(q, v, n_steps=30, dt=DT, substeps=4)
    last = np.stack([toss.q[-1] for toss in tosses])
    off = difference(last, run[:, -1])
    assert np.abs(off[:, :3]).max() < 6 * POSITION
    assert np.abs(off[:, 3:]).max() < 8 * ROTATION


@pytest.mark.parametrize(
    ("name", "values"),
    [("joint_damping", [2e-3]), ("joint_offset", [0.15]), ("joint_stiffness", [0.02, 0.5])],
)
def test_an_effect_of_the_joint_is_named_in_flight(elbow: ObjectModel, name: str, values: list[float]) -> None:
    tosses = seen(with_effect(elbow, name, values), elbow, 14, seed=4, frames=36, height=1.0)
    few = ("joint_damping", "joint_friction", "joint_stiffness", "joint_offset", "gravity", "com_offset")
    found = diagnose(tosses, World(elbow), library=[each for each in library_for(elbow) if each.name in few])
    assert found.named == (name,)
    first = next(finding for finding in found.findings if finding.name == name)
    for interval, truth in zip(first.parameters.values(), values, strict=True):
        # four steps a frame leave half a percent of a tumbling link's rate
        assert interval.low - 0.01 * truth <= truth <= interval.high + 0.01 * truth
    if name == "joint_damping":
        assert (found.place.wrench[0].component, found.place.wrench[0].state) == ("torque_joint_1", "joint_1_rate")
        assert found.place.wrench[0].state_clear
    assert [share.name for share in found.gap.by_channel][-1] == "joint_1"


def test_nothing_is_named_of_a_sound_joint(elbow: ObjectModel) -> None:
    tosses = seen(World(elbow), elbow, 12, seed=5, frames=36, height=1.0)
    few = ("joint_damping", "joint_offset", "gravity")
    found = diagnose(tosses, World(elbow), library=[each for each in library_for(elbow) if each.name in few])
    assert found.verdict == "no_gap"
