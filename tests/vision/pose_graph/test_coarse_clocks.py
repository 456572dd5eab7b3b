"""Offsets of any size between clocks, from motion alone; what motion cannot tell is said."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.motion.handling import Handling
from tests.vision.sights import seen_over_time
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp
from tossid.settings.tracking import TrackSettings
from tossid.types import Detection
from tossid.vision.cameras.rig import default_rig
from tossid.vision.pose_graph.coarse_clocks import CoarseClocks, coarse_clocks
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


def _found(model: ObjectModel, films: dict[int, Film], late: dict[int, float]) -> CoarseClocks:
    """Of what cameras see, by their numbers, with clocks that are late [s]."""
    rng, detections = np.random.default_rng(1), list[Detection]()
    for c, (t, q) in films.items():
        detections += seen_over_time(KNOWN[c], model, t, q, rng, late=late.get(c, 0.0))
    detections.sort(key=lambda d: d.t)
    return coarse_clocks(detections, UNKNOWN, layout_of(model), settings=TrackSettings())


def _part(film: Film, which: slice) -> Film:
    return film[0][which], film[1][which]


@pytest.mark.parametrize("late", [1.3, -4.0, 0.31, 7.7, 1.7e9])
def test_an_offset_is_found_among_several_tosses(tagged: ObjectModel, tosses: Film, late: float) -> None:
    found = _found(tagged, dict.fromkeys(range(2), tosses), {1: late})
    assert found == CoarseClocks({"cam1": pytest.approx(late, abs=2e-3)})


def test_clocks_that_agree_have_no_offset(tagged: ObjectModel, tosses: Film) -> None:
    """Nor have those that the fine search reaches."""
    for late in (0.0, 0.07):
        assert _found(tagged, dict.fromkeys(range(3), tosses), {1: late}) == CoarseClocks()


def test_most_cameras_have_the_right_time(tagged: ObjectModel, tosses: Film) -> None:
    """Also where the first one is the one that is late."""
    found = _found(tagged, dict.fromkeys(range(3), tosses), {0: 2.2})
    assert found.offsets == {"cam0": pytest.approx(2.2, abs=2e-3)}
    found = _found(tagged, dict.fromkeys(range(3), tosses), {1: -0.9, 2: 3.3})
    assert found.offsets == {"cam1": pytest.approx(-0.9, abs=2e-3), "cam2": pytest.approx(3.3, abs=2e-3)}


@pytest.mark.parametrize("every", [5, 10])
def test_a_slow_camera_is_aligned_with_fast_ones(tagged: ObjectModel, tosses: Film, every: int) -> None:
    """Of 30 and 15 frames a second, between the others' frames."""
    t, q = tosses
    between = 0.5 * (q[1:] + q[:-1])
    between[:, 3:7] /= np.linalg.norm(between[:, 3:7], axis=1, keepdims=True)
    slow = 0.5 * (t[1:] + t[:-1])[2::every], between[2::every]
    found = _found(tagged, {0: tosses, 1: slow, 2: tosses}, {1: -4.0})
    assert found.offsets == {"cam1": pytest.approx(-4.0, abs=5e-3)}


def test_a_camera_that_sees_a_part_is_aligned(tagged: ObjectModel, tosses: Film) -> None:
    """It starts late, ends early, and loses the object now and then."""
    t, q = _part(tosses, slice(400, 1200))
    held = np.sin(2.3 * t) > -0.5
    found = _found(tagged, {0: tosses, 1: (t[held], q[held])}, {1: 1.3})
    assert found.offsets == {"cam1": pytest.approx(1.3, abs=3e-3)}


def test_cameras_are_compared_by_way_of_a_third(tagged: ObjectModel, tosses: Film) -> None:
    """The first and the last see nothing at the same time."""
    films = {0: _part(tosses, slice(700)), 1: tosses, 2: _part(tosses, slice(750, None))}
    found = _found(tagged, films, {2: -5.0})
    assert found.offsets == {"cam2": pytest.approx(-5.0, abs=3e-3)}
    assert found.doubts == {}


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


@pytest.mark.parametrize("motion", [_swing, _turntable, _still])
def test_motion_that_repeats_moves_no_clock_that_agrees(
    tagged: ObjectModel, motion: Callable[[np.ndarray], np.ndarray]
) -> None:
    t = np.arange(0, 6, 1 / RATE)
    assert _found(tagged, dict.fromkeys(range(2), (t, motion(t))), {}) == CoarseClocks()


def test_offsets_that_repeat_are_named(tagged: ObjectModel) -> None:
    t = np.arange(0, 6, 1 / RATE)
    found = _found(tagged, dict.fromkeys(range(2), (t, _swing(t))), {1: 1.4})
    assert found.offsets == {}
    assert found.doubts == {"cam1": "what it and cam0 see moves alike at offsets of 1.40 s and 0.40 s"}


def test_tags_of_unknown_place_are_followed_one_by_one(tagged: ObjectModel, tosses: Film) -> None:
    layout = layout_of(tagged)
    loose = [replace(tag, T_body_tag=None) for tag in layout.bodies[-1].tags]
    layout = replace(layout, bodies=(*layout.bodies[:-1], replace(layout.bodies[-1], tags=tuple(loose))))
    rng = np.random.default_rng(2)
    late = [seen_over_time(KNOWN[c], tagged, *tosses, rng, late=2.5 * c) for c in range(2)]
    detections = sorted(late[0] + late[1], key=lambda d: d.t)
    found = coarse_clocks(detections, UNKNOWN[:2], layout, settings=TrackSettings())
    assert found.offsets == {"cam1": pytest.approx(2.5, abs=5e-3)}


def test_detections_come_in_order_of_time(tagged: ObjectModel, tosses: Film) -> None:
    rng = np.random.default_rng(3)
    detections = [d for c in range(2) for d in seen_over_time(KNOWN[c], tagged, *tosses, rng, late=-3.0 * c)]
    detections.sort(key=lambda d: d.t)
    in_time = CoarseClocks({"cam1": -3.0}).in_time(detections)
    for _ in range(2):  # as often as it is asked for
        again = list(in_time)
        assert len(again) == len(detections)
        assert all(a.t <= b.t for a, b in itertools.pairwise(again))
        assert {round(d.t, 9) for d in again} <= {round(t, 9) for t in tosses[0]}


@pytest.mark.parametrize("late", [1.3, -4.0])
def test_a_real_recordings_offset_is_found(shared_data: Path, late: float) -> None:
    """A cube that a hand turns slowly before two cameras, neither of whose places is known."""
    path = shared_data / "tagslam_test" / "test_15"
    entry = recognized_format(path)
    assert entry is not None
    opened = open_recording(entry.settings(path=path))
    last = opened.cameras[-1].name
    stamped = [replace(d, t=d.t + late) if d.camera == last else d for d in opened.detections]
    cameras = tuple(replace(camera, T_rig_cam=None) for camera in opened.cameras)
    found = coarse_clocks(sorted(stamped, key=lambda d: d.t), cameras, opened.layout, settings=TrackSettings())
    assert found.offsets == {last: pytest.approx(late, abs=0.01)}
