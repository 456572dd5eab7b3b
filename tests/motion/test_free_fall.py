"""Free fall of bodies of which nothing is known, one rigid or two on a hinge."""

from __future__ import annotations

import numpy as np
import pytest

from tests.models.made import thrown, toss_of, tosses
from tests.motion.bouncing import noisy
from tossid.errors import InputError
from tossid.motion.free_fall import WINDOW_FRAMES, find_parabola, free_fall
from tossid.motion.links import body_tracks, com_of_moments, determined, moments_of_com, turns
from tossid.motion.phases import phases_of_motion
from tossid.objects import ObjectModel, body_poses, corner_heights, unstated_object
from tossid.objects.unstated import hinge_of
from tossid.rotations import quat_exp, quat_mul, quat_rotate, quat_to_matrix
from tossid.types import Phase, PoseTrack, Toss

COM = np.array([0.004, -0.011, 0.02])
OFF = np.array([0.01, -0.03, 0.02])


def falling(rng: np.random.Generator, *, gravity: float = 9.81, spin: float = 6.0, noise: float = 5e-5) -> Toss:
    """A body whose centre of mass falls, turning about it."""
    t = np.arange(30) / 120
    first = rng.normal(size=4)
    quat = quat_mul(first / np.linalg.norm(first), quat_exp(t[:, None] * spin * rng.normal(size=3)))
    center = rng.normal(size=3) + t[:, None] * rng.normal(size=3) - 0.5 * gravity * t[:, None] ** 2 * [0, 0, 1]
    p = center - quat_to_matrix(quat) @ COM + noise * rng.normal(size=(30, 3))
    return toss_of("t", np.column_stack([p, quat]), dt=1 / 120)


def high(toss: Toss) -> np.ndarray:
    return np.full(len(toss), 1.0)


def test_centre_of_mass_and_gravity_come_back_within_their_errors() -> None:
    rng = np.random.default_rng(0)
    exact = free_fall([falling(rng, gravity=3.7, noise=0.0) for _ in range(4)], unstated_object(), high)
    assert exact.com == pytest.approx(COM[None], abs=1e-9)
    assert exact.gravity == pytest.approx(3.7, abs=1e-8)
    found = free_fall([falling(rng) for _ in range(30)], unstated_object(), high)
    assert (np.abs(found.com - COM) < 3 * found.com_deviation).all()
    assert abs(found.gravity - 9.81) < 3 * found.gravity_deviation
    assert (found.com_deviation < 2e-4).all()


def test_a_hand_in_one_stretch_does_not_pull_the_rest() -> None:
    made = [falling(np.random.default_rng(seed)) for seed in range(20)]
    made[0].q[:, 0] += 0.3 * made[0].t ** 2
    made[0].q[10:, 2] += 0.02
    assert free_fall(made, unstated_object(), high).com == pytest.approx(COM[None], abs=3e-4)


def test_no_flight_or_no_turn_is_refused() -> None:
    rng = np.random.default_rng(3)
    with pytest.raises(InputError, match="0 stretches of flight"):
        free_fall([falling(rng) for _ in range(4)], unstated_object(), lambda toss: np.zeros(len(toss)))
    with pytest.raises(InputError, match="hardly turns"):
        free_fall([falling(rng, spin=0.0, noise=0.0) for _ in range(4)], unstated_object(), high)


@pytest.fixture(scope="module")
def shifted(cube: ObjectModel) -> ObjectModel:
    """A cube whose recorded frame is off its centre of mass."""
    return cube.with_changes(corner_pos=cube.corner_pos + OFF, com=cube.com + OFF)


def test_flight_is_where_the_centre_of_mass_falls(shifted: ObjectModel) -> None:
    rng, tracks = np.random.default_rng(0), []
    for toss in tosses(shifted, 12, seed=2, frames=100, substeps=4):
        tracks.append(PoseTrack(toss.name, toss.t, noisy(toss.q, rng, 1.5e-4, 1e-3)))
    found = find_parabola(tracks)
    assert found.com[0] == pytest.approx(OFF, abs=1e-3)
    assert 0.01 < found.gyration < 0.06
    low = np.concatenate([corner_heights(shifted, track.q).min(axis=1) for track in tracks])
    flying = np.concatenate([found.flying(track.t, track.q) for track in tracks])
    assert flying[low > 0.03].mean() > 0.9  # frames between two impacts may be too few for a parabola
    assert flying[low < 1e-3].mean() < 0.2


def test_phases_of_motion_are_flight_impact_and_rest(shifted: ObjectModel) -> None:
    (toss,) = tosses(shifted, 1, seed=4, frames=220, substeps=4)
    phase = phases_of_motion(find_parabola([PoseTrack(toss.name, toss.t, toss.q)]), toss.t, toss.q, toss.v)
    assert (phase[2], phase[-1]) == (Phase.FLIGHT, Phase.REST)
    assert (phase == Phase.IMPACT).any()
    assert not np.isin(phase, (Phase.SLIDE, Phase.ROLL)).any()


@pytest.mark.parametrize(("joints", "match"), [(0, "no flight"), (1, "one rigid body")])
def test_what_only_slides_or_has_joints_is_refused(joints: int, match: str) -> None:
    t = np.arange(100) / 148
    q = np.zeros((100, 7 + joints))
    q[:, 2], q[:, 3], q[:, 0] = 0.05, 1.0, 0.4 * t
    with pytest.raises(InputError, match=match):
        find_parabola([PoseTrack("slide", t, q)])


# two links


@pytest.fixture(scope="module")
def uneven(elbow: ObjectModel) -> ObjectModel:
    """An elbow whose links are unlike, with masses off their middles."""
    com = np.array([[0.004, -0.01, 0.003], [0.03, 0.005, -0.004]])
    return elbow.with_changes(mass=np.array([0.5, 0.2]), com=com)


def test_parts_say_where_the_common_centre_of_mass_is_and_nothing_else_moves_it(uneven: ObjectModel) -> None:
    q, _ = thrown(np.random.default_rng(0), 5, 1)
    pos, quat = body_poses(uneven, q)
    each = pos + quat_rotate(quat, np.broadcast_to(uneven.com, pos.shape))
    common = np.einsum("b,nbi->ni", uneven.mass / uneven.mass.sum(), each)
    parts, free = moments_of_com(uneven, uneven.com, uneven.mass), determined(uneven)
    assert q[:, :3] + turns(uneven, q) @ parts.ravel() == pytest.approx(common, abs=1e-12)
    assert com_of_moments(uneven, parts, uneven.mass) == pytest.approx(uneven.com, abs=1e-12)
    assert free.shape == (6, 5)
    along = np.linalg.svd(free.T)[2][-1]
    assert turns(uneven, q) @ along == pytest.approx(np.zeros((5, 3)), abs=1e-12)
    # nor does a mass ratio, if the centres of mass go with it
    other = np.array([0.3, 0.4])
    assert moments_of_com(uneven, com_of_moments(uneven, parts, other), other) == pytest.approx(parts, abs=1e-12)
    tracks = body_tracks(uneven, [PoseTrack("a", np.arange(5.0), q)])
    assert tracks[1][0].q == pytest.approx(np.concatenate([pos[:, 1], quat[:, 1]], axis=1))


def test_flight_of_links_is_found_in_their_motion_and_gives_their_parts(uneven: ObjectModel) -> None:
    made = tosses(uneven, 8, seed=2, frames=80)
    tree = unstated_object(hinge=hinge_of(uneven))
    truth, free = moments_of_com(uneven, uneven.com, uneven.mass), determined(uneven)
    parabola = find_parabola([PoseTrack(toss.name, toss.t, toss.q) for toss in made], tree)
    assert free.T @ parabola.com.ravel() == pytest.approx(free.T @ truth.ravel(), abs=2e-4)
    firsts = []
    for toss in made:
        height = corner_heights(uneven, toss.q).min(axis=1)
        assert not parabola.flying(toss.t, toss.q)[height < 1e-4].all()
        phase = phases_of_motion(parabola, toss.t, toss.q, toss.v)
        firsts.append(int(np.argmax(height < 0.02)))
        assert firsts[-1] < 2 * WINDOW_FRAMES or (phase[: firsts[-1]] == Phase.FLIGHT).mean() > 0.9
    assert max(firsts) > 2 * WINDOW_FRAMES
    found = free_fall(made, tree, lambda toss: corner_heights(uneven, toss.q).min(axis=1))
    assert free.T @ found.com.ravel() == pytest.approx(free.T @ truth.ravel(), abs=2e-4)
