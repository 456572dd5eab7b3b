"""Gravity's direction, the ground and places of rest, from motion alone and against truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.tossed import seen
from tests.motion.handling import Handling
from tests.objects.test_shapes import OFFSET, WEDGE, rolled
from tests.vision.tosses import thrown
from tossid.errors import InputError
from tossid.motion import ground_plane
from tossid.motion.ground_plane import find_ground
from tossid.motion.hull_ground import level_by_hull
from tossid.motion.resting import (
    FEWEST_TOSSES,
    REST_FRAMES,
    other_order,
    rest_scatter,
    stands,
)
from tossid.motion.segmentation import segment
from tossid.motion.sessions.levelling import turned_track
from tossid.objects import ObjectModel, corner_positions, unstated_object
from tossid.objects.roundness import directions, ellipsoid
from tossid.physics.effects import World
from tossid.rotations import quat_exp, quat_mul, quat_normalize, quat_rotate, quat_to_matrix, wxyz_to_xyzw, xyzw_to_wxyz
from tossid.types import PoseTrack, Toss

# the ground of a recording in any world


@pytest.mark.parametrize("which", ["cube", "elbow"])
def test_a_tilted_world_is_levelled(which: str, request: pytest.FixtureRequest) -> None:
    model: ObjectModel = request.getfixturevalue(which)
    rng = np.random.default_rng(1)
    made = Handling(model, rng).recording(90.0)
    for size in (0.02, 1.5):
        turn, shift = quat_exp(size * rng.normal(size=3)), rng.normal(size=3)
        track = turned_track(made.tracked(rng), turn, 0.0)
        track.q[:, :3] += shift
        ground = find_ground(track, model)
        normal = quat_to_matrix(turn)[:, 2]
        assert np.linalg.norm(np.cross(normal, ground.up)) < 5e-5
        assert ground.up @ normal > 0
        assert abs(ground.height - normal @ shift) < 5 * np.sqrt(ground.cov[0, 0]) < 2e-4
        assert np.abs(ground.slope).max() < 1e-6
        assert 0.0002 < ground.gravity_sigma < 0.003
        level = ground.levelled(track)
        found, _ = segment(level, model)
        assert len(found) == len(made.release)
        assert min(corner_positions(model, toss.q[-1:])[..., 2].min() for toss in found) > -0.001
        assert level.q_cov is not None


def test_poses_of_one_camera_show_the_ground_too(cube: ObjectModel) -> None:
    rng = np.random.default_rng(5)
    made = Handling(cube, rng).recording(60.0)
    turn = quat_exp(np.array([0.3, -0.2, 0.1]))
    ground = find_ground(turned_track(made.tracked(rng, sigma=2e-3, turn=1e-2), turn, 0.05), cube)
    normal = quat_to_matrix(turn)[:, 2]
    assert ground.n_falling > 60
    assert ground.n_rests > 10
    assert np.linalg.norm(np.cross(normal, ground.up)) < 3e-3
    assert abs(ground.height - 0.05 * normal[2]) < 1e-3


def test_a_ground_that_slopes_is_said_and_gravity_stays_up(cube: ObjectModel) -> None:
    rng, slope = np.random.default_rng(2), np.deg2rad(2.0)
    gravity = (9.81 * np.sin(slope), 0.0, -9.81 * np.cos(slope))
    made = Handling(cube, rng, kinds={"toss": 3, "put down gently": 1}, gravity=gravity).recording(60.0)
    ground = find_ground(made.tracked(rng), cube)
    assert np.linalg.norm(np.cross(ground.up, -np.array(gravity) / 9.81)) < 5 * ground.gravity_sigma
    assert np.linalg.norm(ground.slope) == pytest.approx(np.tan(slope), abs=5 * ground.gravity_sigma)
    assert ground.tilt == pytest.approx(slope, abs=5 * ground.gravity_sigma)


def test_without_flights_the_ground_is_level_and_too_few_rests_are_said(cube: ObjectModel) -> None:
    rng = np.random.default_rng(3)
    made = Handling(cube, rng, kinds={"put down gently": 1}).recording(30.0)
    turn = quat_exp(np.array([0.02, -0.03, 0.0]))
    ground = find_ground(turned_track(made.tracked(rng), turn, 0.05), cube)
    assert not ground.gravity_sigma < 0.01  # a hand's acceleration is now and then gravity's
    assert np.linalg.norm(np.cross(quat_to_matrix(turn)[:, 2], ground.up)) < 5e-4
    q = np.tile([0, 0, 0.0524, 1.0, 0, 0, 0], (100, 1))
    with pytest.raises(InputError, match="1 places"):
        find_ground(PoseTrack("still", np.arange(100) / 148, q), cube)


def test_covariances_count_rests_not_corners(cube: ObjectModel) -> None:
    """Errors that the corners of a rest share do not average out; what is held up is left out."""
    rng, errors = np.random.default_rng(4), []
    for _ in range(30):
        q = np.zeros((60 * 40, 7))
        for k in range(60):
            own = slice(40 * k, 40 * k + 40)
            q[own, :3] = [*rng.uniform(-0.4, 0.4, 2), 0.5 * cube.width + 1e-4 * rng.normal()]
            q[own, 2] += 0.08 if k % 8 == 0 else 0.0
        q[:, 3] = 1.0
        ground = find_ground(PoseTrack("rests", np.arange(len(q)) / 148, q), cube)
        assert (ground.n_rests, ground.n_left_out) == (52, 8)
        errors.append(ground.height**2 / ground.cov[0, 0])
    assert 0.6 < np.mean(errors) < 1.7


def test_short_blocks_give_the_same_ground(cube: ObjectModel, monkeypatch: pytest.MonkeyPatch) -> None:
    track = Handling(cube, np.random.default_rng(7)).recording(60.0).tracked(np.random.default_rng(8))
    whole = find_ground(track, cube)
    monkeypatch.setattr(ground_plane, "BLOCK_FRAMES", 1500)
    parts = find_ground(track, cube)
    assert (parts.n_rests, parts.n_left_out, parts.n_falling) == (whole.n_rests, whole.n_left_out, whole.n_falling)
    assert parts.height == pytest.approx(whole.height, abs=1e-7)
    np.testing.assert_allclose(parts.up, whole.up, atol=1e-7)


# the ground under an object of unknown shape


def rolling(points: np.ndarray) -> list[PoseTrack]:
    return [PoseTrack(toss.name, toss.t, toss.q) for toss in rolled(points, np.random.default_rng(3), tosses=14)]


@pytest.mark.parametrize(("tilt", "lift"), [((0.03, -0.02), 0.0), ((0.0, 0.0), 0.012), ((0.05, 0.03), -0.02)])
def test_a_tilted_and_shifted_ground_is_levelled_by_the_hull(tilt: tuple[float, float], lift: float) -> None:
    level = rolling(WEDGE + OFFSET)
    found, _ = level_by_hull([turned_track(track, quat_exp(np.array([*tilt, 0.0])), lift) for track in level])
    off = np.concatenate([a.q[:, 2] - b.q[:, 2] for a, b in zip(found, level, strict=True)])
    assert np.abs(off).max() < 4e-3  # lower heights are left, as they are also what rounded edges look like
    assert np.ptp(off) < 1.5e-3


@pytest.mark.parametrize("shape", ["wedge", "ellipsoid"])
def test_a_level_ground_is_left_alone_under_edges_and_round_objects(shape: str) -> None:
    surface = ellipsoid([0.06, 0.045, 0.035]).offset(directions(800)[:, None])[:, 0]
    tracks = rolling(WEDGE + OFFSET if shape == "wedge" else surface)
    assert level_by_hull(tracks)[0] is tracks


# stillness and stability


def test_a_cube_stands_on_a_face_and_not_on_an_edge_or_a_corner(cube: ObjectModel, elbow: ObjectModel) -> None:
    rng = np.random.default_rng(5)
    for _ in range(10):
        yaw = quat_exp(np.array([0.0, 0.0, rng.uniform(0, 6)]))
        edge, corner = np.array([rng.uniform(0.2, 1.3), 0.0, 0.0]), np.array([0.6, 0.6, 0.0])
        tilts = [(np.zeros(3), True), (edge, False), (corner, False)]
        for tilt, stable in tilts:
            pose = np.array([*rng.normal(size=3), *quat_normalize(quat_mul(yaw, quat_exp(tilt)))])
            assert stands(cube, pose) == stable
    assert stands(elbow, np.array([0.0, 0.0, 0.025, 1.0, 0.0, 0.0, 0.0, 0.0]))


# scatter of places of rest


@pytest.fixture(scope="module")
def tosses(cube: ObjectModel) -> list[Toss]:
    return seen(World(cube, ground_height=2e-3, ground_tilt=(0.01, 0.0)), cube, 24, seed=11, frames=150)


def moved(toss: Toss, place: np.ndarray | float, turn: np.ndarray | None = None) -> Toss:
    """A toss shifted in the world (3,) or up, and turned in its own axes."""
    q = toss.q.copy()
    q[:, :3] += place if np.ndim(place) else np.array([0.0, 0.0, place])
    if turn is not None:
        q[:, 3:7] = quat_mul(q[:, 3:7], quat_exp(turn))
    return replace(toss, q=q, q_measured=None, q_measured_cov=None)


def test_noise_common_offsets_and_a_frame_that_is_off_are_no_scatter(cube: ObjectModel, tosses: list[Toss]) -> None:
    """A frame that is off puts every side that is down at a height of its own."""
    assert rest_scatter(tosses, cube) == (0.0, 0.0)
    off = np.array([1.3e-3, 5e-4, -9e-4])
    shifted = [moved(toss, quat_rotate(toss.q[:, 3:7], off)) for toss in tosses]
    assert rest_scatter(shifted, cube)[0] == 0.0
    assert rest_scatter(shifted[: 2 * FEWEST_TOSSES - 1], cube)[0] > 2e-4


@pytest.mark.parametrize("over_order", [False, True])
def test_scatter_comes_back(cube: ObjectModel, tosses: list[Toss], over_order: bool) -> None:
    rng = np.random.default_rng(0)
    shifted = [moved(toss, 5e-4 * rng.normal(), 8e-3 * rng.normal(size=3)) for toss in tosses]
    height, tilt = rest_scatter(shifted, cube, over_order=over_order)
    assert (height, tilt) == (pytest.approx(5e-4, rel=0.6), pytest.approx(8e-3, rel=0.6))
    assert rest_scatter(shifted[: FEWEST_TOSSES - 1], cube) == (0.0, 0.0)
    assert rest_scatter([toss.frames(slice(REST_FRAMES - 1)) for toss in shifted], cube) == (0.0, 0.0)


@pytest.mark.parametrize("rise", [[3e-3 * (i >= 14) for i in range(24)], [1e-4 * i for i in range(24)]])
def test_over_the_order_steps_and_drifts_do_not_count(cube: ObjectModel, tosses: list[Toss], rise: list[float]) -> None:
    changing = [moved(toss, up) for toss, up in zip(tosses, rise, strict=True)]
    assert rest_scatter(changing, cube)[0] > 3e-4
    assert rest_scatter(changing, cube, over_order=True)[0] < 1.2e-4


# the order of quaternions


def _tracks(model: ObjectModel, count: int, *, seed: int) -> list[PoseTrack]:
    rng = np.random.default_rng(seed)
    return [PoseTrack(toss.name, toss.t, toss.q) for toss in (thrown(model, rng, name=str(i)) for i in range(count))]


def _reordered(tracks: list[PoseTrack], order) -> list[PoseTrack]:
    return [replace(t, q=np.column_stack([t.q[:, :3], order(t.q[:, 3:7]), t.q[:, 7:]])) for t in tracks]


@pytest.fixture(scope="module")
def thrown_cubes(cube: ObjectModel) -> list[PoseTrack]:
    return _tracks(cube, 12, seed=9)


@pytest.mark.parametrize(("wrong", "right"), [(xyzw_to_wxyz, "qw qx qy qz"), (wxyz_to_xyzw, "qx qy qz qw")])
def test_rests_show_the_order_of_quaternions(
    cube: ObjectModel, elbow: ObjectModel, thrown_cubes: list[PoseTrack], wrong, right: str
) -> None:
    """Columns w x y z that are read as x y z w make w of what was z."""
    w_first = right != "qw qx qy qz"
    for model, tracks in ((cube, thrown_cubes), (unstated_object(), thrown_cubes), (elbow, _tracks(elbow, 6, seed=2))):
        assert other_order(tracks, model, w_first=w_first) is None
        found = other_order(_reordered(tracks, wrong), model, w_first=w_first)
        assert found.name == right
        if model is not elbow:
            assert found.rests == 12
            assert found.flat >= 9 > 1.5 * found.as_read
