"""The stages: when the world is levelled; that problems and counts are reported."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.motion.handling import Handling
from tests.vision.sights import sights, tumble
from tossid.errors import InputError
from tossid.ingestion import stages
from tossid.ingestion.progress import Reporter
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp, quat_mul, quat_to_matrix
from tossid.settings.ingestion import TossSettings
from tossid.types import Detection, PoseTrack
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import default_rig
from tossid.vision.recordings.registry import Opened
from tossid.vision.setup.layout import Body, BodyTag, TagLayout, layout_of


@pytest.fixture(scope="module")
def track(cube: ObjectModel) -> PoseTrack:
    rng = np.random.default_rng(0)
    return Handling(cube, rng).recording(40.0).tracked(rng)


def _opened(cube: ObjectModel, layout: TagLayout) -> Opened:
    return Opened(path=Path("film"), folder=Path("film"), cameras=default_rig(), layout=layout, model=cube)


def _turned(track: PoseTrack, angle: float, height: float) -> PoseTrack:
    turn = quat_exp(np.array([angle, 0.0, 0.0]))
    q = track.q.copy()
    q[:, :3] = q[:, :3] @ quat_to_matrix(turn).T + [0.0, 0.0, height]
    q[:, 3:7] = quat_mul(np.broadcast_to(turn, (len(q), 4)), q[:, 3:7])
    return replace(track, q=q)


@pytest.mark.parametrize(
    ("level", "angle", "height", "tagged", "done"),
    [
        ("auto", 0.0, 0.002, False, False),  # as good as a calibration: only said
        ("auto", 0.1, 0.05, False, True),
        ("auto", 0.0, 0.05, False, True),
        ("auto", 0.1, 0.05, True, False),  # a fixed tag says where the ground is
        ("never", 0.1, 0.05, False, False),
        ("always", 0.0, 0.002, True, True),
    ],
)
def test_when_the_world_is_levelled(
    cube: ObjectModel, track: PoseTrack, level: str, angle: float, height: float, tagged: bool, done: bool
) -> None:
    layout = layout_of(cube)
    if tagged:
        floor = Body("floor", True, np.eye(4), tags=(BodyTag(99, 0.1, np.eye(4)),))
        layout = replace(layout, bodies=(floor, *layout.bodies))
    moved = _turned(track, angle, height)
    report = Reporter(lambda progress: None)
    poses, found = stages.level(_opened(cube, layout), moved, settings=TossSettings(level=level), report=report)
    assert found.levelled is done
    assert found.ground.height == pytest.approx(height * np.cos(angle), abs=2e-4)
    assert bool(report.problems) is (done or height > 0.01)
    q = poses.frames(slice(None)).q
    if done:
        assert np.abs(q[:, 2] - track.q[:, 2]).max() < 1e-3
    else:
        np.testing.assert_array_equal(q, moved.q)


def test_where_there_is_no_toss_the_suspects_are_in_the_line(cube: ObjectModel, track: PoseTrack) -> None:
    q = np.repeat(track.q[:1], 200, axis=0)
    still = PoseTrack("still", np.arange(200) / 148.0, q, None)
    report = Reporter(lambda progress: None)
    report.problem("track", "tags on cube appear 0.8 times as large as stated")
    with pytest.raises(InputError, match=r"no toss in 200 poses of 'cube'; .*; tags on cube appear 0\.8 times"):
        stages.segment_tosses(_opened(cube, layout_of(cube)), still, report=report)


def _tracked(
    tagged: ObjectModel, cameras: tuple[Camera, ...], films: int, *, late: float = 0.0
) -> tuple[list[str], list[str]]:
    """Problems, and all that is said, of a tumble before the first default cameras; the second's clock is late [s]."""
    rng, said, detections = np.random.default_rng(4), list[str](), list[Detection]()
    t, q = tumble(160, rng)
    for c in range(films):
        detections += sights(default_rig()[c : c + 1], tagged, t, q, rng, late=late if c == 1 else 0.0)
    opened = Opened(path=Path("film"), folder=Path("film"), cameras=cameras, layout=layout_of(tagged), model=tagged)
    report = Reporter(lambda progress: said.append(progress.message))
    stages.track(opened, detections, report=report)
    return report.problems, said


def test_a_clock_that_is_set_is_said(tagged: ObjectModel) -> None:
    (problem,), _ = _tracked(tagged, default_rig()[:2], 2, late=-0.6)
    assert problem.startswith("camera cam1's clock is 0.600 s behind cam0's (")
    assert problem.endswith("its times are shifted")


def test_a_camera_whose_sightings_go_is_said(tagged: ObjectModel) -> None:
    """One that stands elsewhere than is said, and one that sees nothing."""
    first, second, third = default_rig()
    moved = third.T_rig_cam.copy()
    moved[:3, 3] += [0.0, 0.1, 0.0]
    problems, said = _tracked(tagged, (first, second, replace(third, T_rig_cam=moved)), 3)
    (line,) = (line for line in said if line.strip().startswith("camera cam2: "))
    assert "sightings of tags are left out (" in line
    assert line.endswith("; are its clock and its calibration right?")
    assert line in problems
    problems, said = _tracked(tagged, (first, second, third), 2)
    assert problems == ["camera cam2 saw no tag of the scene (none dropped)"]
    assert not any("left out" in line for line in said)
