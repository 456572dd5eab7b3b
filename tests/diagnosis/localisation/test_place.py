"""A force that the hypothesis lacks comes back as the residual wrench, with its state; a wrong corner has the gap."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.tossed import seen
from tossid.diagnosis.inference.evidence import Evidence, collect
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.diagnosis.localisation.corners import place_of
from tossid.diagnosis.localisation.place import Relation
from tossid.diagnosis.localisation.relations import COMPONENTS, STATES, relate
from tossid.diagnosis.localisation.wrench import phase_groups, residual_wrench, with_wrench, wrenches
from tossid.objects import ObjectModel
from tossid.physics.effects import World, effect_named
from tossid.rotations import quat_rotate

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
    assert not np.any(flying & touching)
    w = evidence.windows
    frames = [(w.toss[i], w.first[i] + k) for i in np.flatnonzero(flying) for k in range(w.steps[i])]
    assert len(frames) == len(set(frames)), "no frame of flight is in two windows"
    assert touching.sum() > N
    off = (wrench - [*truth, 0, 0, 0])[flying]
    chi2 = np.einsum("wi,wij,wj->w", off, np.linalg.inv(cov[flying]), off)
    assert 3 < chi2.mean() < 9  # of six degrees of freedom
    information = np.linalg.inv(cov[flying])
    mean = np.linalg.solve(information.sum(0), np.einsum("wij,wj->i", information, wrench[flying]))
    error = np.sqrt(np.diag(np.linalg.inv(information.sum(0))))
    assert np.all(np.abs(mean - [*truth, 0, 0, 0]) < 4 * error)
    assert np.all(error[:3] < 2e-3)
    flight, contact = residual_wrench(evidence)
    assert (flight.component, flight.clear, flight.state_clear) == ("force_z", True, False)
    # what slides shows it too, through friction and impacts
    along = contact.means
    for name, value in zip(("force_x", "force_y"), truth, strict=False):
        assert abs(along[name].value - value) < 2.5 * (along[name].high - along[name].low) / 2
    assert set(along) == set(COMPONENTS)


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


@pytest.mark.parametrize("seed", [11, 12])
def test_noise_alone_gives_no_finding(cube: ObjectModel, seed: int) -> None:
    for relation in found(World(cube), cube, seed=seed, n=12).values():
        assert not relation.clear
        assert not relation.state_clear


def test_of_an_object_with_joints_the_force_comes_back(elbow: ObjectModel) -> None:
    truth = np.array([0.3, 0.0, 0.0])
    world = effect_named("uniform_force").at(World(elbow), truth)
    tosses = seen(world, elbow, 8, seed=2, frames=40, height=2.0)
    evidence = collect(make_windows(tosses, elbow), Hypothesis(World(elbow)))
    wrench, cov = wrenches(evidence)
    assert wrench.shape[1] == 3
    information = np.linalg.inv(cov)
    mean = np.linalg.solve(information.sum(0), np.einsum("wij,wj->i", information, wrench))
    np.testing.assert_allclose(mean, truth, atol=0.03)
    assert all(set(relation.means) <= set(COMPONENTS[:5]) for relation in residual_wrench(evidence))


# ---------------------------------------------------------------- relations to states


def test_the_best_of_many_pairs_is_no_finding() -> None:
    claims = 0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        toss = np.repeat(np.arange(15), 3)
        common = rng.normal(size=(15, len(COMPONENTS)))[toss]
        value = common + rng.normal(size=(45, len(COMPONENTS)))
        states = rng.normal(size=(15, len(STATES)))[toss] + 0.3 * rng.normal(size=(45, len(STATES)))
        relation = relate("flight", value, np.ones_like(value), states, toss, rng)
        claims += relation.clear
    assert claims <= 1


@pytest.mark.parametrize("slope", [-0.3, 0.2])
def test_a_linear_dependence_comes_back(slope: float) -> None:
    rng = np.random.default_rng(0)
    toss = np.arange(60) % 20
    states = rng.normal(size=(60, len(STATES)))
    value = 0.05 * rng.normal(size=(60, len(COMPONENTS)))
    k, s = COMPONENTS.index("force_along"), STATES.index("speed")
    value[:, k] += slope * states[:, s]
    relation = relate("flight", value, np.full_like(value, 0.05**2), states, toss, rng)
    assert (relation.component, relation.state) == ("force_along", "speed")
    assert relation.state_clear
    x, fitted, low, high = relation.curve.T
    np.testing.assert_allclose(fitted, slope * x, atol=0.05)
    assert (low <= fitted).all()
    assert (fitted <= high).all()


# ---------------------------------------------------------------- corners


def test_a_wrong_corner_has_the_gap(cube: ObjectModel) -> None:
    wrong, n = 5, 12
    places = cube.corner_pos.copy()
    places[wrong] *= 0.95
    tosses = seen(World(cube.with_changes(corner_pos=places)), cube, n, seed=2)
    shares = place_of(tosses, collect(make_windows(tosses, cube), Hypothesis(World(cube))), None, seed=0).corners
    assert shares[wrong].share.value > 0.6
    assert shares[wrong].share.low > 0.4
    assert sum(c.share.value for c in shares) == pytest.approx(1.0)


def test_what_explains_the_gap_leaves_no_wrench_and_little_at_any_corner(cube: ObjectModel) -> None:
    """Without friction's right value a force against the path is missing; with it, none is."""
    tosses = seen(World(cube.with_changes(friction=0.25)), cube, 14, seed=1)
    stated, friction = Hypothesis(World(cube)), effect_named("friction")
    windows = make_windows(tosses, cube)
    before = collect(windows, stated)
    place = place_of(tosses, before, collect(windows, stated.plus(friction, np.array([0.25]))), seed=0)
    contact = next(each for each in place.wrench if each.phase == "contact")
    assert contact.clear
    assert contact.component == "force_along"
    mean, weight = contact.means["force_along"], cube.mass[0] * 9.81
    assert mean.low < -(0.25 - cube.friction) * weight < mean.high
    assert not any(each.clear for each in place.wrench_left)
    assert sum(c.share.value for c in place.corners) == pytest.approx(1.0)
    assert sum(c.share.value for c in place.corners_left) < 0.1
    alone = place_of(tosses, before, None, seed=0)
    assert alone.corners == alone.corners_left == place.corners
