"""Two links as one falling object."""

from __future__ import annotations

import numpy as np
import pytest

from tests.models.made import thrown, tosses
from tossid.motion.free_fall import free_fall
from tossid.motion.links import body_tracks, com_of_moments, determined, moments_of_com, turns
from tossid.motion.parabola import find_parabola, phases_of_motion
from tossid.objects import ObjectModel, body_poses, corner_positions, unstated_object
from tossid.objects.unstated import hinge_of
from tossid.rotations import quat_rotate
from tossid.types import Phase, PoseTrack


@pytest.fixture(scope="module")
def uneven(elbow: ObjectModel) -> ObjectModel:
    """An elbow whose links are unlike, with masses off their middles."""
    com = np.array([[0.004, -0.01, 0.003], [0.03, 0.005, -0.004]])
    return elbow.with_changes(mass=np.array([0.5, 0.2]), com=com)


def test_parts_say_where_the_common_centre_of_mass_is(uneven: ObjectModel) -> None:
    q, _ = thrown(np.random.default_rng(0), 5, 1)
    pos, quat = body_poses(uneven, q)
    each = pos + quat_rotate(quat, np.broadcast_to(uneven.com, pos.shape))
    common = np.einsum("b,nbi->ni", uneven.mass / uneven.mass.sum(), each)
    parts = moments_of_com(uneven, uneven.com, uneven.mass)
    assert q[:, :3] + turns(uneven, q) @ parts.ravel() == pytest.approx(common, abs=1e-12)
    assert com_of_moments(uneven, parts, uneven.mass) == pytest.approx(uneven.com, abs=1e-12)


def test_what_is_not_determined_moves_nothing(uneven: ObjectModel) -> None:
    q, _ = thrown(np.random.default_rng(0), 5, 1)
    free = determined(uneven)
    assert free.shape == (6, 5)
    along = np.linalg.svd(free.T)[2][-1]
    assert turns(uneven, q) @ along == pytest.approx(np.zeros((5, 3)), abs=1e-12)
    # nor does a mass ratio, if the centres of mass go with it
    parts = moments_of_com(uneven, uneven.com, uneven.mass)
    other = np.array([0.3, 0.4])
    assert moments_of_com(uneven, com_of_moments(uneven, parts, other), other) == pytest.approx(parts, abs=1e-12)


def test_each_link_has_its_own_track(elbow: ObjectModel) -> None:
    q, _ = thrown(np.random.default_rng(0), 5, 1)
    tracks = body_tracks(elbow, [PoseTrack("a", np.arange(5.0), q)])
    pos, quat = body_poses(elbow, q)
    assert tracks[1][0].q == pytest.approx(np.concatenate([pos[:, 1], quat[:, 1]], axis=1))


def test_flight_of_links_is_found_in_their_motion_and_gives_their_parts(uneven: ObjectModel) -> None:
    made = tosses(uneven, 8, seed=2, frames=80)
    tree = unstated_object(hinge=hinge_of(uneven))
    truth, free = moments_of_com(uneven, uneven.com, uneven.mass), determined(uneven)
    parabola = find_parabola([PoseTrack(toss.name, toss.t, toss.q) for toss in made], tree)
    assert free.T @ parabola.com.ravel() == pytest.approx(free.T @ truth.ravel(), abs=2e-4)
    clear = [corner_positions(uneven, toss.q)[..., 2].min(axis=1) for toss in made]
    for toss, height in zip(made, clear, strict=True):
        assert not parabola.flying(toss.t, toss.q)[height < 1e-4].all()
        phase = phases_of_motion(parabola, toss.t, toss.q, toss.v)
        first = int(np.argmax(height < 0.02))
        assert first < 2 * parabola.frames or (phase[:first] == Phase.FLIGHT).mean() > 0.9
    assert max(int(np.argmax(height < 0.02)) for height in clear) > 2 * parabola.frames
    found = free_fall(made, tree, lambda toss: corner_positions(uneven, toss.q)[..., 2].min(axis=1))
    assert free.T @ found.com.ravel() == pytest.approx(free.T @ truth.ravel(), abs=2e-4)
    assert found.gravity == pytest.approx(9.81, abs=1e-3)
