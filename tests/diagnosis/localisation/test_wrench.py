"""A force that the hypothesis lacks comes back as the residual wrench, with the state it depends on; a corner that is
wrong has the gap; and of noise nothing is claimed."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.tossed import seen, seen_with_joint
from tossid.diagnosis.inference.evidence import Evidence, collect
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.diagnosis.localisation.place import Relation
from tossid.diagnosis.localisation.relations import COMPONENTS
from tossid.diagnosis.localisation.wrench import phase_groups, residual_wrench, with_wrench, wrenches
from tossid.objects import ObjectModel
from tossid.physics.effects import World, effect_named
from tossid.rotations import quat_rotate
from tossid.types import Phase

N = 18


def missed(truth: World, nominal: ObjectModel, *, seed: int, n: int = N) -> Evidence:
    """The evidence of the stated world, of tosses of another."""
    return collect(make_windows(seen(truth, nominal, n, seed=seed), nominal), Hypothesis(World(nominal)))


def found(truth: World, nominal: ObjectModel, *, seed: int, n: int = N) -> dict[str, Relation]:
    """By phase, the relation that a stated world which lacks the truth's forces leaves."""
    return {r.phase: r for r in residual_wrench(missed(truth, nominal, seed=seed, n=n))}


def test_a_uniform_force_comes_back_within_its_errors(cube: ObjectModel) -> None:
    truth = np.array([0.05, -0.03, 0.08])
    evidence = missed(effect_named("uniform_force").at(World(cube), truth), cube, seed=1)
    wrench, cov = wrenches(evidence)
    flying, touching = phase_groups(evidence.windows)
    assert flying.sum() > 0.8 * N
    assert touching.sum() > N
    off = (wrench - [*truth, 0, 0, 0])[flying]
    chi2 = np.einsum("wi,wij,wj->w", off, np.linalg.inv(cov[flying]), off)
    assert 3 < chi2.mean() < 9  # of six degrees of freedom
    information = np.linalg.inv(cov[flying])
    mean = np.linalg.solve(information.sum(0), np.einsum("wij,wj->i", information, wrench[flying]))
    error = np.sqrt(np.diag(np.linalg.inv(information.sum(0))))
    assert np.all(np.abs(mean - [*truth, 0, 0, 0]) < 4 * error)
    assert np.all(error[:3] < 2e-3)
    # what slides shows it too, through friction and impacts
    along = residual_wrench(evidence)[1].means
    for name, value in zip(("force_x", "force_y"), truth, strict=False):
        assert abs(along[name].value - value) < 2.5 * (along[name].high - along[name].low) / 2
    assert set(along) == set(COMPONENTS)


def test_no_frame_of_flight_is_in_two_windows(cube: ObjectModel) -> None:
    w = make_windows(seen(World(cube), cube, N, seed=2), cube)
    flying, touching = phase_groups(w)
    assert not np.any(flying & touching)
    frames = [(w.toss[i], w.first[i] + k) for i in np.flatnonzero(flying) for k in range(w.steps[i])]
    assert len(frames) == len(set(frames))
    assert np.all((w.phase == Phase.FLIGHT)[flying] | ~w.inside[flying])


def test_a_torque_turns_the_body_about_its_centre_of_mass(cube: ObjectModel) -> None:
    world = World(effect_named("com_offset").at(World(cube), np.array([4e-3, -6e-3, 5e-3])).object)
    q = np.array([[0.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0]])
    torque = np.array([3e-4, -2e-4, 5e-4])
    steps, dt = 30, 1 / 148
    free, turned = (
        w.roll_out(q, np.zeros((1, 6)), n_steps=steps, dt=dt, substeps=16)[0]
        for w in (world, with_wrench(world, np.array([0, 0, 0, *torque])))
    )
    com = world.object.com[0]
    places = [run[:, :3] + quat_rotate(run[:, 3:7], com) for run in (free, turned)]
    np.testing.assert_allclose(places[0], places[1], atol=2e-4)
    angle = 2 * turned[-1, 4:7]
    about = np.linalg.solve(world.object.inertia[0], torque)
    np.testing.assert_allclose(angle, 0.5 * about * (steps * dt) ** 2, rtol=0.03)


def test_a_torque_is_added_to_what_was_learned(cube: ObjectModel) -> None:
    once = with_wrench(World(cube), np.array([0, 0, 0, 2e-4, 0, -1e-4]))
    twice = with_wrench(once, np.array([0, 0, 0, 1e-4, 3e-4, 0]))
    both = with_wrench(World(cube), np.array([0, 0, 0, 3e-4, 3e-4, -1e-4]))
    q, v = np.array([[0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0]]), np.array([[0.5, 0, 0, 2.0, 1.0, 0]])
    runs = [w.roll_out(q, v, n_steps=60, dt=1 / 148, substeps=4) for w in (twice, both)]
    np.testing.assert_allclose(runs[0], runs[1], atol=1e-9)


def test_drag_is_explained_by_a_velocity(cube: ObjectModel) -> None:
    c = 0.06
    relation = found(effect_named("linear_drag").at(World(cube), np.array([c])), cube, seed=1)["flight"]
    assert relation.clear
    assert relation.state_clear
    assert relation.component.startswith("force")
    assert relation.state in ("velocity_x", "velocity_y", "velocity_z", "horizontal_speed", "speed")
    assert relation.r2.value > 0.7
    x, fitted = relation.curve[:, 0], relation.curve[:, 1]
    assert np.polyfit(x, fitted, 1)[0] == pytest.approx(-c, abs=0.02)


def test_a_uniform_force_needs_no_state(cube: ObjectModel) -> None:
    truth = effect_named("uniform_force").at(World(cube), np.array([0.0, 0.0, 0.1]))
    relation = found(truth, cube, seed=3)["flight"]
    assert relation.component == "force_z"
    assert relation.clear
    assert not relation.state_clear
    mean = relation.means["force_z"]
    assert mean.low - 0.003 < 0.1 < mean.high + 0.003


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_noise_alone_gives_no_finding(cube: ObjectModel, seed: int) -> None:
    for relation in found(World(cube), cube, seed=seed, n=12).values():
        assert not relation.clear
        assert not relation.state_clear


def test_of_an_object_with_joints_the_force_comes_back(elbow: ObjectModel) -> None:
    truth = np.array([0.3, 0.0, 0.0])
    world = effect_named("uniform_force").at(World(elbow), truth)
    tosses = seen_with_joint(world, elbow, 8, seed=2, frames=40, height=2.0)
    evidence = collect(make_windows(tosses, elbow), Hypothesis(World(elbow)))
    wrench, cov = wrenches(evidence)
    assert wrench.shape[1] == 3
    information = np.linalg.inv(cov)
    mean = np.linalg.solve(information.sum(0), np.einsum("wij,wj->i", information, wrench))
    np.testing.assert_allclose(mean, truth, atol=0.03)
    for relation in residual_wrench(evidence):
        assert set(relation.means) <= set(COMPONENTS[:5])
