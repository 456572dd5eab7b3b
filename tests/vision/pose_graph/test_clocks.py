"""Offsets of any size between clocks: found by the motion that cameras share, refined by the graph; or doubts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.motion.handling import Handling
from tests.vision.sights import sights, tumble
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp
from tossid.settings.tracking import TrackSettings
from tossid.types import Detection
from tossid.vision.cameras.rig import default_rig
from tossid.vision.pose_graph.clocks import Clocks, clock_offsets
from tossid.vision.pose_graph.track import track_scene
from tossid.vision.recordings.registry import open_recording, recognized_format
from tossid.vision.setup.layout import layout_of

KNOWN = default_rig()
UNKNOWN = (KNOWN[0], *(replace(camera, T_rig_cam=None) for camera in KNOWN[1:]))
"""Cameras of which only the first one's place is known."""
RATE = 148.0
Film = tuple[np.ndarray, np.ndarray]
"""Times (n,) [s], and configurations (n, 7)."""


@pytest.fixture(scope="module")
def tosses(tagged: ObjectModel) -> Film:
    """Five tosses in eleven seconds, with what a hand does between them."""
    made = Handling(tagged, np.random.default_rng(0), kinds={"toss": 1}).recording(10.0)
    return made.t, made.q


def _found(model: ObjectModel, films: dict[int, Film], late: dict[int, float]) -> Clocks:
    """Of what cameras see, by their numbers, with clocks that are late [s]."""
    rng, detections = np.random.default_rng(1), list[Detection]()
    for c, (t, q) in films.items():
        detections += sights(KNOWN[c : c + 1], model, t, q, rng, late=late.get(c, 0.0))
    detections.sort(key=lambda d: d.t)
    return clock_offsets(detections, UNKNOWN, layout_of(model), settings=TrackSettings())


def _part(film: Film, which: slice) -> Film:
    return film[0][which], film[1][which]


def _slow(film: Film, every: int) -> Film:
    """What a slower camera sees, between the other's frames."""
    t, q = film
    between = 0.5 * (q[1:] + q[:-1])
    between[:, 3:7] /= np.linalg.norm(between[:, 3:7], axis=1, keepdims=True)
    return 0.5 * (t[1:] + t[:-1])[2::every], between[2::every]


def _partly(film: Film) -> Film:
    """Of a camera that starts late, ends early, and loses the object now and then."""
    t, q = _part(film, slice(400, 1200))
    held = np.sin(2.3 * t) > -0.5
    return t[held], q[held]


FILMS: dict[str, Callable[[Film], dict[int, Film]]] = {
    "two": lambda film: dict.fromkeys(range(2), film),
    "three": lambda film: dict.fromkeys(range(3), film),
    "15 Hz between the others' frames": lambda film: {0: film, 1: _slow(film, 10), 2: film},
    "one sees a part": lambda film: {0: film, 1: _partly(film)},
    "by way of a third": lambda film: {0: _part(film, slice(700)), 1: film, 2: _part(film, slice(750, None))},
}
"""What each camera sees of a film."""


@pytest.mark.parametrize(
    ("films", "late", "right"),
    [
        *(("two", {1: late}, {1: late}) for late in (0.003, 0.31, -4.0, 1.7e9)),
        ("three", {0: 2.2}, {0: 2.2}),  # most cameras have the right time, though the first is late
        ("three", {1: -0.9, 2: 3.3}, {1: -0.9, 2: 3.3}),
        ("15 Hz between the others' frames", {1: -4.0}, {1: -4.0}),
        ("one sees a part", {1: 1.3}, {1: 1.3}),
        ("by way of a third", {2: -5.0}, {2: -5.0}),
    ],
)
def test_motion_shows_offsets(
    tagged: ObjectModel, tosses: Film, films: str, late: dict[int, float], right: dict[int, float]
) -> None:
    found = _found(tagged, FILMS[films](tosses), late)
    expected = {f"cam{c}": pytest.approx(offset, abs=5e-3 if "Hz" in films else 3e-3) for c, offset in right.items()}
    assert found == Clocks(expected)


def test_cameras_that_share_no_motion_are_in_doubt(tagged: ObjectModel, tosses: Film) -> None:
    """One sees the first half and the other the second, or each sees other tosses."""
    apart = _found(tagged, {0: _part(tosses, slice(700)), 1: _part(tosses, slice(720, None))}, {1: 1.3})
    others = Handling(tagged, np.random.default_rng(5), kinds={"toss": 1}).recording(8.0)
    different = _found(tagged, {0: tosses, 1: (others.t, others.q)}, {})
    for found in (apart, different):
        assert found.offsets == {}
        (why,) = found.doubts.values()
        assert "too little motion in common" in why or "alike at no offset" in why


def _swing(t: np.ndarray) -> np.ndarray:
    turn = np.array([0.5, 0.3, 1.0]) * np.sin(2 * np.pi * t + 1)[:, None]
    return np.hstack([0.2 * np.sin(2 * np.pi * t)[:, None], 0 * t[:, None], 0 * t[:, None] + 0.2, quat_exp(turn)])


def _turntable(t: np.ndarray) -> np.ndarray:
    return np.hstack([np.tile([0.0, 0.1, 0.2], (len(t), 1)), quat_exp(4 * t[:, None] * [0.0, 0.0, 1.0])])


def _still(t: np.ndarray) -> np.ndarray:
    return np.tile([0.0, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0], (len(t), 1))


@pytest.mark.parametrize(
    ("motion", "late", "expected"),
    [
        (_swing, 0.0, Clocks()),
        (_turntable, 0.0, Clocks()),
        (_still, 0.0, Clocks()),
        (_swing, 0.07, Clocks({"cam1": pytest.approx(0.07, abs=2e-3)})),  # nobody may have noticed it
        (_swing, 1.4, Clocks({}, {"cam1": "what it and cam0 see moves alike at offsets of 1.40 s and 0.40 s"})),
    ],
)
def test_motion_that_repeats_moves_no_clock_that_agrees_and_doubts_are_named(
    tagged: ObjectModel, motion: Callable[[np.ndarray], np.ndarray], late: float, expected: Clocks
) -> None:
    t = np.arange(0, 6, 1 / RATE)
    assert _found(tagged, dict.fromkeys(range(2), (t, motion(t))), {1: late}) == expected


def test_tags_of_unknown_place_are_followed_one_by_one(tagged: ObjectModel, tosses: Film) -> None:
    layout = layout_of(tagged)
    loose = [replace(tag, T_body_tag=None) for tag in layout.bodies[-1].tags]
    layout = replace(layout, bodies=(*layout.bodies[:-1], replace(layout.bodies[-1], tags=tuple(loose))))
    rng = np.random.default_rng(2)
    late = [d for c in range(2) for d in sights(KNOWN[c : c + 1], tagged, *tosses, rng, late=2.5 * c)]
    detections = sorted(late, key=lambda d: d.t)
    found = clock_offsets(detections, UNKNOWN[:2], layout, settings=TrackSettings())
    assert found.offsets == {"cam1": pytest.approx(2.5, abs=5e-3)}


@pytest.mark.parametrize(("late", "every", "known"), [(0.0405, 1, True), (-4.0, 5, False)])
def test_an_offset_of_any_size_is_estimated(tagged: ObjectModel, late: float, every: int, known: bool) -> None:
    """Of cameras at known places or not, of one rate or 148 and 30 frames a second; no sighting is lost."""
    rng, cameras = np.random.default_rng(2), default_rig(n_cameras=2)
    t, q = tumble(4 * 200, rng, rate_hz=4 * 148)
    detections = list(sights(cameras[:1], tagged, t[::4], q[::4], rng))
    detections += sights(cameras[1:], tagged, t[2 :: 4 * every], q[2 :: 4 * every], rng, late=late)
    if not known:
        cameras = (cameras[0], replace(cameras[1], T_rig_cam=None))
    found = track_scene(detections, cameras, layout_of(tagged))
    assert found.report.clocks.keys() == {"cam1"}
    offset, sigma = found.report.clocks["cam1"]
    assert offset == pytest.approx(late, abs=max(5 * sigma, 1e-4))
    assert sigma < 2e-4  # of frames that are 6.8 ms apart
    assert sum(found.report.left_out.get("cam1", {}).values()) < 0.02 * found.report.sightings["cam1"]
    poses = found.tracks["cube"]
    truth = q[np.clip(np.round(poses.t * 4 * 148).astype(int), 0, len(q) - 1)]
    assert np.median(np.linalg.norm(poses.q[:, :3] - truth[:, :3], axis=1)) < 2e-3  # mostly by one camera alone


def test_clocks_that_agree_are_left_alone(tagged: ObjectModel) -> None:
    rng, true = np.random.default_rng(3), default_rig(n_cameras=2)
    t, q = tumble(160, rng)
    detections = list(sights(true, tagged, t, q, rng))
    cameras = (true[0], replace(true[1], T_rig_cam=None))
    report = track_scene(detections, cameras, layout_of(tagged)).report
    assert report.clocks == report.clock_doubts == {}
    assert report.suspects == []


def test_a_real_recordings_offset_is_found(shared_data: Path) -> None:
    """A hand turns a cube slowly before two cameras at 8 frames a second; neither of their places is known."""
    path, late = shared_data / "tagslam_test" / "test_15", -4.0
    opened = open_recording(recognized_format(path).settings(path=path))  # type: ignore[union-attr]
    last = opened.cameras[-1].name
    stamped = [replace(d, t=d.t + late) if d.camera == last else d for d in opened.detections]
    cameras = tuple(replace(camera, T_rig_cam=None) for camera in opened.cameras)
    found = clock_offsets(sorted(stamped, key=lambda d: d.t), cameras, opened.layout, settings=TrackSettings())
    assert found.offsets == {last: pytest.approx(late, abs=0.01)}
