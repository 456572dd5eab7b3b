"""The synthetic recording's motion: continuous, off the ground, and free only where it is free."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.vision.films import film_of
from tests.vision.tosses import thrown
from tossid.errors import InputError
from tossid.objects import ObjectModel, corner_positions
from tossid.rotations import geodesic_angle
from tossid.synthesis.timeline import Filming, Timeline, make_timeline, render_timeline
from tossid.vision.cameras.rig import default_rig
from tossid.vision.recordings.formats.frames import read_recording
from tossid.vision.recordings.writing import RecordingWriter
from tossid.vision.setup.layout import layout_of

DT = 1 / 148


@pytest.fixture(scope="module")
def made(cube: ObjectModel):
    rng = np.random.default_rng(0)
    tosses = [thrown(cube, rng, name=f"t{i}") for i in range(5)]
    return tosses, make_timeline(tosses, cube, rng, start=3.0)


def test_the_tosses_are_in_one_continuous_motion_of_a_hand(made, cube: ObjectModel) -> None:
    """It lets go at the release's velocity, nothing before that is free fall, and nothing goes into the ground."""
    tosses, timeline = made
    for toss, true, release, rest in zip(tosses, timeline.tosses, timeline.release, timeline.rest, strict=True):
        n = rest - release + 1
        np.testing.assert_allclose(timeline.q[release : rest + 1], toss.q[:n], atol=1e-12)
        np.testing.assert_allclose(true.t, timeline.t[release : rest + 1])
        np.testing.assert_array_equal(true.v, toss.v[:n])
        before = (timeline.q[release, :3] - timeline.q[release - 1, :3]) / DT
        # half a frame earlier the hand's acceleration, at most 15 m/s², makes the difference
        np.testing.assert_allclose(before, toss.v[0, :3], atol=0.5 * 16 * DT + 0.02)
        z = timeline.q[release - 3 : release, 2]
        assert (z[2] - 2 * z[1] + z[0]) / DT**2 > 2.0
    np.testing.assert_allclose(np.diff(timeline.t), DT, rtol=1e-9)
    assert np.linalg.norm(np.diff(timeline.q[:, :3], axis=0), axis=1).max() < 8.0 * DT
    assert geodesic_angle(timeline.q[1:, 3:7], timeline.q[:-1, 3:7]).max() < 40.0 * DT
    assert corner_positions(cube, timeline.q)[..., 2].min() > -2e-3


def test_uneven_tosses_are_refused(made, cube: ObjectModel):
    tosses, _ = made
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="even rate"):
        make_timeline([tosses[0], replace(tosses[1], t=2 * tosses[1].t)], cube, rng)
    with pytest.raises(InputError, match="no tosses"):
        make_timeline([], cube, rng)


def test_images_depend_on_the_seed_and_not_on_threads(made, tagged: ObjectModel, tmp_path: Path):
    _, timeline = made
    short = replace(timeline, t=timeline.t[:6], q=timeline.q[:6])
    cameras = default_rig(n_cameras=2, resolution=(160, 128))
    images = []
    for threads in (1, 2):
        done: list[int] = []
        writer = RecordingWriter(tmp_path / "rec", cameras, layout_of(tagged))
        rng = np.random.default_rng(4)
        truth = render_timeline(short, tagged, cameras, writer, rng, threads=threads, progress=done.append)
        assert truth.kept.sum() == 12
        assert sum(done) == 12
        images.append([frame.image for frame in read_recording(tmp_path / "rec")])
    np.testing.assert_array_equal(images[0], images[1])


def test_dropped_frames_are_gone_and_the_others_as_they_were(
    tagged: ObjectModel, timeline: Timeline, rig, tmp_path: Path
):
    whole, everything = film_of(timeline, tagged, rig[:2], tmp_path / "a", Filming())
    part, truth = film_of(timeline, tagged, rig[:2], tmp_path / "b", Filming(dropped=0.3))
    assert everything.kept.all()
    assert truth.kept.mean() == pytest.approx(0.7, abs=0.06)
    assert part.n_frames == truth.kept.sum()
    for c, camera in enumerate(part.cameras):
        stamps = np.array([file.t_ns for file in part.frames[camera.name]]) * 1e-9
        np.testing.assert_allclose(stamps, timeline.t[truth.kept[:, c]], atol=1e-9)
    for file in part.frames["cam1"][:20]:
        twin = next(other for other in whole.frames["cam1"] if other.t_ns == file.t_ns)
        assert file.path.read_bytes() == twin.path.read_bytes()
