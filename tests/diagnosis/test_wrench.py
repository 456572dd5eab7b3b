"""A force that the hypothesis lacks comes back as the residual wrench, with the state it depends on; a corner that is
wrong has the gap; and of noise nothing is claimed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.diagnosis.by_hand import diagnosis, gap
from tests.diagnosis.tossed import seen
from tests.evaluation.figures.reading import assert_legible, words
from tests.models.conftest import cube
from tossid.diagnosis import gap as gaps
from tossid.diagnosis.evidence import Evidence, Hypothesis
from tossid.diagnosis.findings import Corner, Diagnosis, Gap, Interval, Place, Relation
from tossid.diagnosis.gap import measure_gap, noise_floor
from tossid.diagnosis.judging import Judge, folds
from tossid.diagnosis.place import corner_shares
from tossid.diagnosis.place_figures import corners, place_figures
from tossid.diagnosis.place_figures import residual_wrench as wrench_figure
from tossid.diagnosis.report import report_html
from tossid.diagnosis.whitening import linearise
from tossid.diagnosis.windows import make_windows
from tossid.diagnosis.words import place_of, where_words
from tossid.diagnosis.wrench import (
    COMPONENTS,
    STATES,
    phase_groups,
    relate,
    residual_wrench,
    with_wrench,
    wrenches,
)
from tossid.objects import ObjectModel, corner_positions, load_object
from tossid.physics.effects import LIBRARY, World
from tossid.rotations import quat_rotate
from tossid.types import Phase

__all__ = ["cube"]

NAMES = {effect.name: effect for effect in LIBRARY}
N = 18


def missed(truth: World, stated: World, nominal: ObjectModel, *, seed: int, n: int = N) -> tuple[Evidence, np.ndarray]:
    """The evidence of tosses of one world around another, and its residual."""
    tosses = seen(truth, nominal, n, seed=seed)
    evidence = Evidence(*linearise(make_windows(tosses, nominal), stated, refine=3))
    return evidence, evidence.residual(stated)


def found(truth: World, nominal: ObjectModel, *, seed: int, n: int = N) -> dict[str, Relation]:
    """By phase, the relation that a stated world which lacks the truth's forces leaves."""
    stated = World(nominal)
    evidence, residual = missed(truth, stated, nominal, seed=seed, n=n)
    return {r.phase: r for r in residual_wrench(evidence, Hypothesis(stated), residual, nominal)}


# ---------------------------------------------------------------- the wrench of a window


def test_a_uniform_force_comes_back_within_its_errors(cube: ObjectModel) -> None:
    truth = np.array([0.05, -0.03, 0.08])
    stated = World(cube)
    evidence, residual = missed(NAMES["uniform_force"].at(stated, truth), stated, cube, seed=1)
    wrench, cov = wrenches(evidence, Hypothesis(stated), residual)
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
    along = residual_wrench(evidence, Hypothesis(stated), residual, cube)[1].means
    for name, value in zip(("force_x", "force_y"), truth, strict=False):
        assert abs(along[name].value - value) < 2.5 * (along[name].high - along[name].low) / 2
    assert set(along) == set(COMPONENTS)


def test_no_frame_of_flight_is_in_two_windows(cube: ObjectModel) -> None:
    evidence, _ = missed(World(cube), World(cube), cube, seed=2)
    w = evidence.windows
    flying, touching = phase_groups(w)
    assert not np.any(flying & touching)
    frames = [(w.toss[i], w.frame[i, 0] + k) for i in np.flatnonzero(flying) for k in range(w.steps[i])]
    assert len(frames) == len(set(frames))
    assert np.all((w.phase == Phase.FLIGHT)[flying] | ~w.inside[flying])


def test_a_torque_turns_the_body_about_its_centre_of_mass(cube: ObjectModel) -> None:
    world = World(NAMES["com_offset"].at(World(cube), np.array([4e-3, -6e-3, 5e-3])).object)
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


# ---------------------------------------------------------------- the state that explains it


def test_drag_is_explained_by_a_velocity(cube: ObjectModel) -> None:
    c = 0.06
    relation = found(NAMES["linear_drag"].at(World(cube), np.array([c])), cube, seed=1)["flight"]
    assert relation.clear
    assert relation.state_clear
    assert relation.component.startswith("force")
    assert relation.state in ("velocity_x", "velocity_y", "velocity_z", "horizontal_speed", "speed")
    assert relation.r2.value > 0.7
    x, fitted = relation.curve[:, 0], relation.curve[:, 1]
    assert np.polyfit(x, fitted, 1)[0] == pytest.approx(-c, abs=0.02)
    said = where_words([relation])[0]
    assert "is missing that depends on" in said


def test_a_uniform_force_needs_no_state(cube: ObjectModel) -> None:
    truth = NAMES["uniform_force"].at(World(cube), np.array([0.0, 0.0, 0.1]))
    relation = found(truth, cube, seed=3)["flight"]
    assert relation.component == "force_z"
    assert relation.clear
    assert not relation.state_clear
    mean = relation.means["force_z"]
    assert mean.low - 0.003 < 0.1 < mean.high + 0.003
    assert "and no state more" in where_words([relation])[0]


def test_missing_friction_is_a_force_against_the_path(cube: ObjectModel) -> None:
    truth = NAMES["friction"].at(World(cube), np.array([0.25]))
    relation = found(truth, cube, seed=1, n=20)["contact"]
    assert relation.clear
    assert relation.component == "force_along"
    weight = cube.mass[0] * 9.81
    mean = relation.means["force_along"]
    assert mean.low < -(0.25 - cube.friction) * weight < mean.high


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_of_noise_nothing_is_claimed(cube: ObjectModel, seed: int) -> None:
    for relation in found(World(cube), cube, seed=seed, n=12).values():
        assert not relation.clear
        assert not relation.state_clear
        assert "no force or torque is clearly missing" in where_words([relation])[0]


def test_the_best_of_many_pairs_is_no_finding() -> None:
    claims = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        toss = np.repeat(np.arange(15), 3)
        common = rng.normal(size=(15, len(COMPONENTS)))[toss]
        value = common + rng.normal(size=(45, len(COMPONENTS)))
        states = rng.normal(size=(15, len(STATES)))[toss] + 0.3 * rng.normal(size=(45, len(STATES)))
        relation = relate("flight", value, np.ones_like(value), states, toss, rng)
        assert relation is not None
        claims += relation.clear
    assert claims <= 1


def test_few_windows_say_nothing() -> None:
    one = np.ones((4, len(COMPONENTS)))
    assert relate("flight", one, one, np.ones((4, len(STATES))), np.arange(4), np.random.default_rng(0)) is None


# ---------------------------------------------------------------- corners


def contact_gap(nominal: ObjectModel, wrong: int, *, n: int = 12) -> tuple[list, Gap]:
    """Tosses whose excess is 2 in contact while corner `wrong` is the lowest, else 0.2; 5 in flight."""
    tosses = seen(World(nominal), nominal, n, seed=4)
    rows = []
    for i, toss in enumerate(tosses):
        lowest = corner_positions(nominal, toss.q)[..., 2].argmin(1)
        for k in range(1, len(toss)):
            excess = 5.0 if toss.phase[k] == Phase.FLIGHT else 2.0 if lowest[k] == wrong else 0.2
            rows.append((i, k * (toss.t[1] - toss.t[0]), toss.phase[k], excess))
    return tosses, replace(gap(2.0, n=n), frames=np.array(rows))


def test_shares_of_corners_add_up(cube: ObjectModel) -> None:
    tosses, made = contact_gap(cube, 3)
    shares = corner_shares(tosses, World(cube), made, 1 / 148)
    assert sum(c.share.value for c in shares) == pytest.approx(1.0)
    np.testing.assert_allclose([c.place for c in shares], cube.corner_pos)
    touching = sum(int((toss.phase[1:] != Phase.FLIGHT).sum()) for toss in tosses)
    assert touching <= sum(c.frames for c in shares) <= 4 * touching
    assert max(range(8), key=lambda c: shares[c].per_frame or 0.0) == 3
    half = replace(made, frames=made.frames * [1, 1, 1, 0.5])
    left = corner_shares(tosses, World(cube), half, 1 / 148, whole=made)
    assert sum(c.share.value for c in left) == pytest.approx(0.5)


def test_no_gap_in_contact_is_not_shared_out(cube: ObjectModel) -> None:
    tosses, made = contact_gap(cube, 3)
    noise = made.frames.copy()
    noise[:, 3] = np.where(noise[:, 2] == Phase.FLIGHT, 5.0, np.random.default_rng(0).normal(size=len(noise)))
    assert corner_shares(tosses, World(cube), replace(made, frames=noise), 1 / 148) == ()


def test_a_wrong_corner_has_the_gap(cube: ObjectModel, monkeypatch: pytest.MonkeyPatch) -> None:
    wrong, n = 5, 12
    places = cube.corner_pos.copy()
    places[wrong] *= 0.95
    tosses = seen(World(cube.with_changes(corner_pos=places)), cube, n, seed=2)
    judge = Judge(make_windows(tosses, cube), n, folds(n, np.random.default_rng(0)))
    first = judge.start(Hypothesis(World(cube)))
    monkeypatch.setattr(gaps, "LENGTHS", ())
    measured = measure_gap(tosses, first, judge, noise_floor(first, judge, seed=0))
    shares = corner_shares(tosses, World(cube), measured, 1 / 148)
    assert shares[wrong].share.value > 0.6
    assert shares[wrong].share.low > 0.4
    assert sum(c.share.value for c in shares) == pytest.approx(1.0)


# ---------------------------------------------------------------- pictures, page and json


def placed(model: ObjectModel) -> Diagnosis:
    """A diagnosis with a place: drag in flight, nothing in contact, and one corner that is worst."""
    rng = np.random.default_rng(0)
    n = 40
    toss = np.arange(n) % 20
    states = rng.normal(size=(n, len(STATES)))
    value, variance = 0.05 * rng.normal(size=(n, len(COMPONENTS))), np.full((n, len(COMPONENTS)), 1e-3)
    value[:, 3] -= 0.3 * states[:, STATES.index("horizontal_speed")]
    flight = relate("flight", value, variance, states, toss, np.random.default_rng(1))
    contact = relate("contact", rng.normal(size=value.shape), variance, states, toss, np.random.default_rng(1))
    assert flight is not None
    assert contact is not None
    shares = np.array([0.5, *np.full(7, 0.5 / 7)])
    both = [
        tuple(
            Corner((float(x), float(y), float(z)), Interval(k * s, k * s / 2, k * s * 2), 40, 8 * k * s)
            for (x, y, z), s in zip(model.corner_pos, shares, strict=True)
        )
        for k in (1.0, 0.3)
    ]
    return replace(diagnosis(model), place=Place((flight, contact), both[0], (flight,), both[1]))


def test_the_pictures_of_the_place_are_legible(cube: ObjectModel) -> None:
    made = placed(cube)
    figures = place_figures(made)
    assert list(figures) == ["gap_wrench", "gap_corners"]
    for figure in figures.values():
        assert_legible(figure)
    assert "force along the path [N]" in words(figures["gap_wrench"])
    assert "horizontal speed [m/s]" in words(figures["gap_wrench"])
    assert place_of(cube.corner_pos[0]) in words(figures["gap_corners"])
    alone = replace(made, named=(), place=replace(made.place, wrench_left=(), corners_left=()))
    assert_legible(wrench_figure(alone))
    assert_legible(corners(alone))
    many = replace(made, named=("friction", "com_offset", "linear_drag", "restitution", "ground_tilt"))
    for figure in place_figures(many).values():
        assert_legible(figure)


def test_a_body_of_other_corners_is_drawn(cube: ObjectModel) -> None:
    elbow = load_object(Path(__file__).parents[2] / "conf/object/elbow.xml")
    made = placed(cube)
    for places in (elbow.corner_pos[:6], cube.corner_pos[:4], np.tile(elbow.corner_pos, (3, 1))):
        shares = tuple(replace(made.place.corners[0], place=tuple(place.tolist())) for place in places)
        some = replace(made, named=(), place=replace(made.place, corners=shares, corners_left=()))
        assert_legible(corners(some))


def test_the_page_has_them_in_its_details(cube: ObjectModel) -> None:
    made = placed(cube)
    page = report_html(made, {}, about="", details=place_figures(made))
    assert page.index("On which corner") > page.index("Details")
    assert page.count("data:image/png") == 2
    assert "a force along the path is missing that depends on the horizontal speed" in page
    plain = report_html(diagnosis(cube), {}, about="")
    assert "On which corner" not in plain


def test_gap_json_says_where(cube: ObjectModel) -> None:
    made = json.loads(json.dumps(placed(cube).as_json(), allow_nan=False))
    corner = made["gap"]["by_corner"][0]
    assert set(corner) >= {"corner", "share", "ci95", "frames"}
    relation = made["gap"]["wrench"][0]
    assert (relation["component"], relation["state"]) == ("force_along", "horizontal_speed")
    assert relation["clear"] is True
    assert relation["r2"]["ci95"][0] <= relation["r2"]["value"]
    assert len(made["gap_left"]["by_corner"]) == 8
