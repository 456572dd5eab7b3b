"""Detections and poses come back from their temporary files."""

from __future__ import annotations

from tempfile import TemporaryFile

import numpy as np
import pytest

from tossid.errors import MotionError
from tossid.types import Detection, PoseTrack
from tossid.vision.recordings import disk_buffer
from tossid.vision.recordings.disk_buffer import DetectionSpool, PoseSpool


def _part(first: int, n: int, *, cov: bool = True) -> PoseTrack:
    rng = np.random.default_rng(first)
    quat = rng.normal(size=(n, 4))
    q = np.hstack([rng.normal(size=(n, 3)), quat / np.linalg.norm(quat, axis=1, keepdims=True)])
    q_cov = np.einsum("nij,nkj->nik", *2 * [rng.normal(size=(n, 6, 6))])
    return PoseTrack("film", (first + np.arange(n)) / 148, q, q_cov if cov else None)


def test_detections_can_be_read_again_and_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disk_buffer, "AT_ONCE", 7)
    rng = np.random.default_rng(0)
    given = [
        Detection(f"cam{i % 3}", i / 10, i, rng.normal(size=(4, 2)), rng.normal(size=(4, 2, 2)), i % 2, float(i))
        for i in range(40)
    ]
    with TemporaryFile() as file:
        kept = DetectionSpool(iter(given), file)
        for _ in range(2):
            for mine, theirs in zip(kept, given, strict=True):
                assert (mine.camera, mine.t, mine.tag_id, mine.hamming, mine.margin) == (
                    theirs.camera, theirs.t, theirs.tag_id, theirs.hamming, theirs.margin
                )  # fmt: skip
                np.testing.assert_array_equal(mine.corners, theirs.corners)
                np.testing.assert_array_equal(mine.corner_cov, theirs.corner_cov)


@pytest.mark.parametrize("cov", [True, False])
def test_a_tracks_stretches_are_read_as_one(cov: bool) -> None:
    parts = [_part(0, 10, cov=cov), _part(10, 5, cov=cov), _part(20, 8, cov=cov)]
    with TemporaryFile() as file:
        spool = PoseSpool(file)
        assert spool.track() is None
        for part in parts:
            spool.add(part)
        track = spool.track()
        assert track is not None
        found = track.frames(slice(7, 18))
        np.testing.assert_array_equal(found.q, np.concatenate([part.q for part in parts])[7:18])
        np.testing.assert_array_equal(found.t, np.concatenate([part.t for part in parts])[7:18])
        assert (found.q_cov is not None) is cov
        if found.q_cov is not None:
            np.testing.assert_array_equal(found.q_cov, np.concatenate([part.q_cov for part in parts])[7:18])


def test_stretches_that_do_not_follow_are_refused() -> None:
    with TemporaryFile() as file:
        spool = PoseSpool(file)
        spool.add(_part(0, 10))
        with pytest.raises(MotionError, match="does not increase"):
            spool.add(_part(5, 10))
        with pytest.raises(MotionError, match="other columns"):
            spool.add(_part(20, 10, cov=False))
