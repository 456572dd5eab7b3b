"""The hinge between two links: recovered from noisy poses in any frames, and refused where there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.models.made import thrown
from tossid.errors import InputError
from tossid.motion.hinge import find_hinge, hinged_tracks
from tossid.objects import ObjectModel, body_poses, unstated_object
from tossid.rotations import geodesic_angle, quat_exp, quat_mul, quat_rotate
from tossid.types import PoseTrack

Tracks = tuple[list[PoseTrack], list[PoseTrack]]
FRAMES = 120


def links(
    model: ObjectModel, rng: np.random.Generator, *, place: float = 0.0, turn: float = 0.0, swing: float = 1.0
) -> Tracks:
    """Poses of both links of an elbow that tumbles and swings, each in a frame of its own, with noise."""
    found: Tracks = ([], [])
    frames = [(0.05 * rng.normal(size=3), quat_exp(rng.normal(size=3))) for _ in range(2)]
    for i in range(12):
        first, _ = thrown(rng, 1, 1)
        t = np.arange(FRAMES) / 148
        q = np.repeat(first, FRAMES, axis=0)
        q[:, 3:7] = quat_mul(first[:, 3:7], quat_exp(t[:, None] * rng.normal(size=3) * 6))
        q[:, 7] = swing * np.sin(6 * t + i)
        pos, quat = body_poses(model, q)
        for body, (track, (at, way)) in enumerate(zip(found, frames, strict=True)):
            p = pos[:, body] + quat_rotate(quat[:, body], at) + place * rng.normal(size=(FRAMES, 3))
            turned = quat_mul(quat_mul(quat[:, body], way), quat_exp(turn * rng.normal(size=(FRAMES, 3))))
            track.append(PoseTrack(f"{i}", t, np.concatenate([p, turned], axis=1)))
    return found


def test_the_hinge_of_exact_poses_is_exact_and_gives_them_back(elbow: ObjectModel) -> None:
    first, second = links(elbow, np.random.default_rng(0))
    found = find_hinge(first, second)
    assert found.tilt < 1e-7
    assert found.offset < 1e-9
    tracks, model = hinged_tracks(first, second, found), unstated_object(hinge=found.hinge)
    for track, one, two in zip(tracks, first, second, strict=True):
        pos, quat = body_poses(model, track.q)
        for body, own in enumerate((one, two)):
            assert np.abs(pos[:, body] - own.q[:, :3]).max() < 1e-8
            assert geodesic_angle(quat[:, body], own.q[:, 3:7]).max() < 1e-7


def test_noise_and_lost_frames_move_it_little_and_both_links_make_poses_better_than_one(elbow: ObjectModel) -> None:
    exact = links(elbow, np.random.default_rng(3))
    truth = find_hinge(*exact)
    first, second = links(elbow, np.random.default_rng(3), place=1.5e-4, turn=2e-3)
    fused = hinged_tracks(first, second, find_hinge(first, second))[0].q
    together, alone = (geodesic_angle(q[:, 3:7], exact[0][0].q[:, 3:7]) for q in (fused, first[0].q))
    assert np.sqrt((together**2).mean()) < 0.9 * np.sqrt((alone**2).mean())
    second[4].q[30:36, :3] += 0.2  # a tracker that is lost for six frames
    found = find_hinge(first, second)
    assert abs(found.hinge.axis @ truth.hinge.axis) > np.cos(5e-4)
    assert np.linalg.norm(np.cross(found.hinge.pos - truth.hinge.pos, truth.hinge.axis)) < 1.5e-4


def slide(track: PoseTrack) -> PoseTrack:
    return replace(track, q=track.q + np.pad(0.02 * np.sin(9 * track.t)[:, None], ((0, 0), (2, 4))))


def bend(track: PoseTrack) -> PoseTrack:
    bent = quat_exp(np.outer(0.3 * np.cos(11 * track.t), [1.0, 0.0, 0.0]))
    return replace(track, q=np.column_stack([track.q[:, :3], quat_mul(track.q[:, 3:7], bent)]))


@pytest.mark.parametrize(
    ("swing", "spoil", "match"),
    [
        (0.02, lambda track: track, "the joint hardly moves"),
        (1.0, slide, r"common point is off by .* mm or more in 20 % of the frames \(a slide"),
        (1.0, bend, r"common axis is off by .*more than one axis"),
    ],
)
def test_what_is_no_hinge_is_refused(elbow: ObjectModel, swing: float, spoil, match: str) -> None:
    first, second = links(elbow, np.random.default_rng(1), turn=2e-3 if swing < 1 else 0.0, swing=swing)
    with pytest.raises(InputError, match=match):
        find_hinge(first, [spoil(track) for track in second])
